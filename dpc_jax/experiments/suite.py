"""The whole command: what is asked for, the runs that are missing, the page."""

import dataclasses
from collections.abc import Collection
from pathlib import Path

from dpc_jax.experiments.page import make_page
from dpc_jax.experiments.results import Outcome, Results, measure_mean_shapes
from dpc_jax.experiments.runs import SIZES, Request, Run
from dpc_jax.experiments.training import Job, choose_cores, train_missing
from dpc_jax.run.process import catch_signals
from dpc_jax.run.workdir import hold_workdir, make_workdir


@dataclasses.dataclass(frozen=True)
class Place:
    """Where things lie.

    Attributes:
      folder: DIR, with a folder per run under runs/.
      cache: of rendered data sets.
      page: Markdown file to write beside DIR's own; None for none.
    """

    folder: Path
    cache: Path
    page: Path | None = None


def run_suite(
    request: Request, place: Place, trained: Collection[str], *, at_once: int = 0
) -> tuple[Path, int]:
    """Train what is missing of some runs, then write the page of the request.

    Args:
      request: what is asked for.
      place: where it lies.
      trained: names of the runs to train; none writes the page of what is there.
      at_once: how many runs at most; 0 for as many as there are cores and memory.

    Returns:
      The page, and how many of the runs failed.

    Raises:
      ValueError: where another command uses DIR.
      OSError: where DIR cannot be written.
      KeyboardInterrupt: where Ctrl-C stopped it; the runs have saved.
    """
    make_workdir(place.folder)
    runs, failed = request.list_runs(), 0
    with hold_workdir(place.folder), catch_signals() as stop:
        planned = {run.name: _plan(run, request, place) for run in runs}
        problems = {n: p for n, p in planned.items() if isinstance(p, str)}
        jobs = {n: job for n, job in planned.items() if isinstance(job, Job)}
        if asked := [job for name, job in jobs.items() if name in trained]:
            cores = choose_cores(at_once)
            problems |= train_missing(asked, cores=cores, stop=stop)
        failed = len(problems.keys() & set(trained))
        outcomes = {
            run.name: _gather(run, jobs.get(run.name), place, problems) for run in runs
        }
        results = Results(request, outcomes)
        measured = measure_mean_shapes(results, place.folder / "measured")
        page = make_page(
            dataclasses.replace(results, mean_shapes=measured), place.folder
        )
        path = page.write()
        if place.page and not stop.is_set():
            page.publish(place.page)
    return path, failed


def _plan(run: Run, request: Request, place: Place) -> Job | str:
    """The job of a run, or why its config cannot work."""
    try:
        config = run.load_config()
    except ValueError as error:
        return str(error)
    data = dataclasses.replace(config.data, cache_dir=str(place.cache))
    return Job(
        run,
        dataclasses.replace(config, data=data),
        place.folder / "runs" / run.name,
        place.folder / "logs" / f"{run.name}.txt",
        SIZES[request.size].environment,
    )


def _gather(
    run: Run, job: Job | None, place: Place, problems: dict[str, str]
) -> Outcome:
    workdir, problem = place.folder / "runs" / run.name, problems.get(run.name, "")
    if job is None:
        return Outcome(run, workdir, problem=problem)
    try:
        return Outcome(run, workdir, job.config, job.read_metrics(), problem)
    except ValueError as error:
        return Outcome(run, workdir, job.config, problem=str(error))
