"""The whole command: what is asked for, the runs that are missing, the page."""

import dataclasses
import json
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from dpc_jax.experiments.analyses import Analysis, analyze
from dpc_jax.experiments.jobs.progress import JobProgress
from dpc_jax.experiments.jobs.training import Job, choose_cores, train_missing
from dpc_jax.experiments.measured_rows import measure_rows
from dpc_jax.experiments.report.blocks import Block
from dpc_jax.experiments.report.page import make_blocks, publish, write_page
from dpc_jax.experiments.results import Outcome, Results, read_metrics
from dpc_jax.experiments.runs import Request, Run, Source, list_runs
from dpc_jax.experiments.sizes import SIZES
from dpc_jax.files import write_json
from dpc_jax.run.process import catch_signals
from dpc_jax.run.workdir import hold_workdir, make_workdir

_ASKED = "requests.json"


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

    def locate(self, run: Run) -> Path:
        """The folder of a run."""
        return self.folder / "runs" / run.name


def run_suite(
    request: Request,
    place: Place,
    runs: Sequence[Run],
    *,
    at_once: int = 0,
) -> tuple[Path, int]:
    """Train what is missing of some runs, then write the page of all that DIR has.

    Args:
      request: what is asked for now; what DIR was asked for before stays on the page.
      place: where it lies.
      runs: of the request, to train; none of them writes the page of what is there.
      at_once: how many runs at most; 0 for as many as there are cores and memory.

    Returns:
      The page, and how many of the runs failed.

    Raises:
      ValueError: for a request that cannot work or does not fit what is in DIR, or
        another command that uses DIR.
      OSError: where DIR cannot be written.
      KeyboardInterrupt: where Ctrl-C stopped it; the runs have saved.
    """
    make_workdir(place.folder)
    with hold_workdir(place.folder):
        requests = _remember(place.folder, request)
        with catch_signals() as stop:
            suite = _Suite(place, requests)
            if runs:
                suite.train(runs, at_once, stop)
            path = suite.write(is_last=not stop.is_set())
            if stop.is_set():
                print("Stopped: the runs have saved, and the same command goes on.")
    return path, len(suite.problems.keys() & {run.name for run in runs})


class _Suite:
    """What the folder has, and the page of it."""

    def __init__(self, place: Place, requests: list[Request]):
        self.place, self.requests = place, requests
        self.problems: dict[str, str] = {}
        self.written = self.writing = 0.0  # when the page was, and how long it took
        self.jobs: dict[str, Job] = {}
        for run in list_runs(requests):
            self._plan(run)

    def _plan(self, run: Run):
        """A run whose config cannot work fails by itself, not with the others."""
        try:
            config = run.load_config()
        except ValueError as error:
            self.problems[run.name] = str(error)
            return
        data = dataclasses.replace(config.data, cache_dir=str(self.place.cache))
        self.jobs[run.name] = Job(
            run,
            dataclasses.replace(config, data=data),
            self.place.locate(run),
            self.place.folder / "logs" / f"{run.name}.txt",
            SIZES[self.requests[0].size].environment,
        )

    def train(self, runs: Iterable[Run], at_once: int, stop):
        """Train the runs that are not finished."""
        names = [run.name for run in runs]
        asked = [self.jobs[name] for name in names if name in self.jobs]
        missing = [job for job in asked if not job.is_finished()]
        done = len(asked) - len(missing)
        for name in self.problems.keys() & set(names):
            print(f"{name} failed: {self.problems[name]}", flush=True)
        if not missing:
            print(f"{done} of {len(names)} runs are finished.", flush=True)
            return
        self.write()
        cores = choose_cores(at_once)
        print(
            f"{len(missing)} runs to train, {done} finished, {len(cores)} at once.",
            flush=True,
        )
        with JobProgress(total=len(asked), done=done) as progress:
            self.problems |= train_missing(
                missing,
                cores=cores,
                progress=progress,
                stop=stop,
                on_end=lambda job: self._write_now_and_then(),
            )

    def _write_now_and_then(self):
        """Write the page beside the runs, for a tenth of their time at most."""
        if time.monotonic() - self.written > 9 * self.writing:
            self.write()

    def write(self, *, is_last: bool = False) -> Path:
        """Write the page of all that is there; analyses only at the end."""
        started = time.monotonic()
        outcomes = {run.name: self._read(run) for run in list_runs(self.requests)}
        folder = self.place.folder
        measured = measure_rows(
            Results(self.requests, outcomes), folder / "analyses", is_last=is_last
        )
        results = Results(self.requests, outcomes, measured)
        analyses: Mapping[str, Analysis] = {}
        if is_last:
            analyses = analyze(results, folder / "analyses")
        blocks: list[Block] = make_blocks(results, analyses, figures=folder / "figures")
        if is_last and self.place.page:
            publish(self.place.page, blocks)
        path = write_page(folder, blocks)
        self.written = time.monotonic()
        self.writing = self.written - started
        return path

    def _read(self, run: Run) -> Outcome:
        workdir = self.place.locate(run)
        problem = self.problems.get(run.name, "")
        job = self.jobs.get(run.name)
        if job is None or not job.is_finished():
            return Outcome(run, workdir, problem=problem)
        try:
            return Outcome(run, workdir, job.config, read_metrics(workdir), problem)
        except ValueError as error:
            return Outcome(run, workdir, problem=str(error))


def _remember(folder: Path, request: Request) -> list[Request]:
    """Add a request to those of the folder; all of them.

    Raises:
      ValueError: where those before are of another size or source.
    """
    path = folder / _ASKED
    before = _read_requests(path)
    for name in ("size", "source"):
        then = {getattr(r, name) for r in before}
        now = getattr(request, name)
        if then - {now}:
            raise ValueError(
                f"The folder {folder} must have one {name}, but it was begun with "
                f"{_describe(then.pop())} and is now asked for {_describe(now)}; give "
                "another --out=DIR."
            )
    requests = list(dict.fromkeys([*before, request]))
    write_json(path, [dataclasses.asdict(r) for r in requests])
    return requests


def _describe(value) -> str:
    if isinstance(value, Source):
        return " ".join(part for part in (value.kind, value.folder) if part)
    return str(value)


def _read_requests(path: Path) -> list[Request]:
    if not path.exists():
        return []
    try:
        return [
            Request(
                experiment=fields["experiment"],
                size=fields["size"],
                source=Source(**fields["source"]),
                categories=tuple(fields["categories"]),
                seeds=tuple(fields["seeds"]),
            )
            for fields in json.loads(path.read_text(encoding="utf-8"))
        ]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"Expected what was asked for in {path}, but it cannot be read ({error}); "
            "remove the file, and give the same commands again."
        ) from None
