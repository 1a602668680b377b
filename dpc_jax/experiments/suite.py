"""The whole command: what is asked for, the runs that are missing, the page."""

import dataclasses
from pathlib import Path

from dpc_jax.experiments.page import write_page
from dpc_jax.experiments.results import Outcome, Results
from dpc_jax.experiments.runs import SIZES, Request
from dpc_jax.experiments.training import Job, choose_cores, train_missing
from dpc_jax.learning.inference.predictor import VIEWS_AT_ONCE
from dpc_jax.run.process import catch_signals, prepare_process
from dpc_jax.run.workdir import hold_workdir


def run_suite(
    request: Request,
    folder: Path,
    *,
    trains: bool,
    cache: Path,
    at_once: int = 0,
) -> tuple[Path, int]:
    """Train what is missing of some runs, then write the page of the request.

    Args:
      request: what is asked for.
      folder: DIR, with a folder per run under runs/.
      trains: whether what is missing is trained, or left out of the page.
      cache: of rendered data sets.
      at_once: how many runs at most; 0 for as many as there are cores and memory.

    Returns:
      The page, and how many of the runs failed.

    Raises:
      ValueError: where another command uses DIR.
      OSError: where DIR cannot be written.
      KeyboardInterrupt: where Ctrl-C stopped it; the runs have saved.
    """
    prepare_process(VIEWS_AT_ONCE)  # the networks of finished runs are asked here
    with hold_workdir(folder), catch_signals() as stop:
        jobs, problems = _plan(request, folder, cache)
        if trains:
            cores = choose_cores(at_once)
            problems |= train_missing(list(jobs.values()), cores=cores, stop=stop)
        outcomes = {
            run.name: _gather(run, folder, jobs.get(run.name), problems)
            for run in request.list_runs()
        }
        path = write_page(Results(request, outcomes), folder)
    return path, len(problems) if trains else 0


def _plan(
    request: Request, folder: Path, cache: Path
) -> tuple[dict[str, Job], dict[str, str]]:
    """The jobs of all runs, and of others why their config cannot work, by name."""
    jobs, problems = {}, {}
    for run in request.list_runs():
        try:
            config = run.load_config()
        except ValueError as error:
            problems[run.name] = str(error)
            continue
        data = dataclasses.replace(config.data, cache_dir=str(cache))
        jobs[run.name] = Job(
            run,
            dataclasses.replace(config, data=data),
            folder / "runs" / run.name,
            folder / "logs" / f"{run.name}.txt",
            SIZES[request.size].environment,
        )
    return jobs, problems


def _gather(run, folder, job: Job | None, problems) -> Outcome:
    workdir, problem = folder / "runs" / run.name, problems.get(run.name, "")
    try:
        return Outcome(run, workdir, job.read_metrics() if job else None, problem)
    except ValueError as error:
        return Outcome(run, workdir, problem=str(error))
