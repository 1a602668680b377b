"""The whole command: what is asked for, the runs that are missing, the page."""

import dataclasses
from pathlib import Path

from dpc_jax.experiments.page import write_page
from dpc_jax.experiments.results import Outcome, Results
from dpc_jax.experiments.runs import SIZES, Request, Run
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
      ValueError: where another command uses DIR, or a config cannot work.
      OSError: where DIR cannot be written.
      KeyboardInterrupt: where Ctrl-C stopped it; the runs have saved.
    """
    prepare_process(VIEWS_AT_ONCE)  # the networks of finished runs are asked here
    with hold_workdir(folder), catch_signals() as stop:
        jobs = [_make_job(run, request, folder, cache) for run in request.list_runs()]
        problems = {}
        if trains:
            problems = train_missing(jobs, cores=choose_cores(at_once), stop=stop)
        outcomes = {
            job.run.name: _gather(job, problems.get(job.run.name, "")) for job in jobs
        }
        path = write_page(Results(request, outcomes), folder)
    return path, len(problems)


def _make_job(run: Run, request: Request, folder: Path, cache: Path) -> Job:
    config = run.load_config()
    data = dataclasses.replace(config.data, cache_dir=str(cache))
    return Job(
        run,
        dataclasses.replace(config, data=data),
        folder / "runs" / run.name,
        folder / "logs" / f"{run.name}.txt",
        SIZES[request.size].environment,
    )


def _gather(job: Job, problem: str) -> Outcome:
    try:
        return Outcome(job.run, job.workdir, job.read_metrics(), problem)
    except ValueError as error:
        return Outcome(job.run, job.workdir, problem=str(error))
