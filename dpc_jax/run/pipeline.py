"""One run from config to report: data, training, evaluation, report."""

import contextlib
import functools
import time
from collections.abc import Callable
from pathlib import Path

from dpc_jax import config as configs
from dpc_jax.config import Config
from dpc_jax.learning.devices import make_mesh
from dpc_jax.learning.training.records import MetricLog, NonFiniteError
from dpc_jax.run.hosts.agreement import Job
from dpc_jax.run.hosts.joining import joining
from dpc_jax.run.hosts.places import Place
from dpc_jax.run.hosts.writing import SilentLog
from dpc_jax.run.learner import Learner
from dpc_jax.run.process import prepare_process
from dpc_jax.run.report.summary import report_run
from dpc_jax.run.setup import load_sets
from dpc_jax.run.task import Task, run_command
from dpc_jax.run.training import train_learner
from dpc_jax.run.workdir import (
    check_same,
    claim_workdir,
    hold_workdir,
    read_config,
)


def run_guarded(
    config: Config,
    *,
    config_path: str,
    workdir: str | None,
    place: Place | None = None,
) -> int:
    """`run`, with expected failures as one sentence and an exit status."""
    task = Task(
        functools.partial(
            run, config, config_path=config_path, workdir=workdir, place=place
        ),
        out=Path(workdir or "runs"),
        interrupted="Interrupted; start again in the same workdir to go on.",
        errors=(ValueError, OSError, NonFiniteError),
    )
    return run_command(lambda: task)


def judge_guarded(
    config: Config, *, config_path: str, workdir: str | None, judge: Callable
) -> int:
    """What judges the finished run of a config, guarded in the same way.

    Args:
      judge: `judge_finally`, `judge_photographs`.
    """
    folder = Path(workdir or _name_workdir(config, config_path))

    def run_judge():
        check_same(folder, read_config(folder), config)
        prepare_process(1, 1)
        judge(folder, cache_dir=config.data.cache_dir)

    errors = ValueError, OSError
    return run_command(lambda: Task(run_judge, folder, "Interrupted.", errors=errors))


def run(
    config: Config,
    *,
    config_path: str,
    workdir: str | None,
    place: Place | None = None,
):
    """Train where that is left to do, then evaluate on the test split and report.

    Args:
      config: of the run.
      config_path: file it came from, for the default workdir's name.
      workdir: folder of the run; runs/NAME-seedN where None.
      place: of this process among those of a job; None where it is on its own.

    Raises:
      ValueError: for a config that cannot work, a workdir made by another one, or one
        that another process is using.
      OSError: where the workdir cannot be written.
      NonFiniteError: where training breaks.
    """
    configs.check(config)
    processes = place.processes if place else 1
    objects = max(1, config.train.models_per_batch // processes)
    prepare_process(objects, config.run.devices // processes)
    folder = Path(workdir or _name_workdir(config, config_path))
    with joining(place) as job, contextlib.ExitStack() as held:
        job.check_same(config)

        def take_workdir():
            held.enter_context(hold_workdir(folder))
            claim_workdir(folder, config)

        job.do_first(take_workdir)
        print(f"Workdir: {folder}", flush=True)
        _run_in(folder, config, job)


def _run_in(folder, config, job):
    # These refuse before anything is rendered.
    make_mesh(config)
    log = _open_log(folder, config, job)
    started = time.monotonic()
    sets = load_sets(config)
    data_seconds = time.monotonic() - started

    learner = Learner(config, sets)
    with contextlib.closing(log):
        outcome = train_learner(learner, folder, log, job)
    if not outcome.is_finished:
        print(
            f"Stopped and saved at step {int(outcome.state.step)}; start again in the "
            "same workdir to go on."
        )
        return
    found = learner.evaluate_test(outcome.state)
    if not job.is_first:
        return
    refined = None
    if config.eval.refine:
        # Only where asked for.
        from dpc_jax.learning.inference.refinement import measure_refinement

        print("Refining the test views.", flush=True)
        refined = measure_refinement(
            learner.network,
            config,
            outcome.state,
            sets["test"],
            found.predictions,
            validated=found.validated,
            alignment=found.alignment,
        )
    report_run(
        folder,
        config,
        sets,
        outcome,
        found,
        records=log.read(),
        data_seconds=data_seconds,
        refined=refined,
    )


def _open_log(folder: Path, config, job: Job) -> MetricLog:
    if not job.is_first:
        return SilentLog()
    path = folder / "metrics.jsonl"
    if not config.log.tensorboard:
        return MetricLog(path)
    from dpc_jax.run.tensorboard import TensorBoardLog  # only where asked for

    return TensorBoardLog(path, folder / "tensorboard")


def _name_workdir(config, config_path):
    """runs/car-paper-seed0, for instance."""
    variant = config.variant.replace(",", "-")
    parts = (Path(config_path).stem, variant, f"seed{config.seed}")
    return Path("runs") / "-".join(part for part in parts if part)
