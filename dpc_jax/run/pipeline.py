"""One run from config to report: data, training, evaluation, report."""

import contextlib
import functools
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp

from dpc_jax import config as configs
from dpc_jax.config import Config, replace_fields
from dpc_jax.learning.devices import make_mesh
from dpc_jax.learning.inference.predictor import compile_predictor
from dpc_jax.learning.step import TrainState, describe_state, init_state
from dpc_jax.learning.training import loop
from dpc_jax.learning.training.agreement import Job
from dpc_jax.learning.training.checkpoints import Checkpoints, Restored, restore_last
from dpc_jax.learning.training.records import MetricLog, TensorBoardLog
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.run.hosts import Place
from dpc_jax.run.hosts.joining import joining
from dpc_jax.run.learner import Learner
from dpc_jax.run.process import catch_signals, prepare_process
from dpc_jax.run.report.summary import report_run
from dpc_jax.run.setup import load_sets, make_network
from dpc_jax.run.workdir import (
    check_same,
    claim_workdir,
    hold_workdir,
    list_differences,
    read_config,
)

# Fields that the shapes of parameters depend on.
_OF_NETWORK = (
    *("network.", "pose.", "render.num_points", "render.grid", "render.scale_fixed"),
    *("train.color_weight", "train.colors_move_points", "data.image_size"),
)
_GB = 1e9


def judge(config: Config, folder: Path, judge_run: Callable):
    """Have the finished run of a config judged by `judge_finally`, for instance.

    Raises:
      ValueError: where the folder holds no finished run of that config.
    """
    check_same(folder, read_config(folder), config)
    prepare_process(1, 1)
    judge_run(folder, cache_dir=config.data.cache_dir)


def run(config: Config, folder: Path, place: Place | None = None):
    """Train where that is left to do, then evaluate on the test split and report.

    Args:
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
        outcome = _train(learner, folder, log, job)
    if not outcome.is_finished:
        print(
            f"Stopped and saved at step {int(outcome.state.step)}; start again in the "
            "same workdir to go on."
        )
        return
    found = learner.predict_test(outcome.state)
    if job.is_first:
        report_run(folder, learner, outcome, found, log.read(), data_seconds)


def _open_log(folder: Path, config, job: Job) -> MetricLog:
    path = folder / "metrics.jsonl" if job.is_first else None
    if path and config.log.tensorboard:
        return TensorBoardLog(path, folder / "tensorboard")
    return MetricLog(path)


def _train(learner: Learner, workdir: Path, log: MetricLog, job: Job) -> loop.Outcome:
    """Train to the last step, or until SIGTERM or Ctrl-C asks to save and stop."""
    checkpoints = Checkpoints(workdir / "checkpoints", job)
    start = _restore_run(learner, checkpoints, log, job)
    with contextlib.closing(checkpoints), catch_signals() as stop:
        if int(start.state.step) >= learner.config.train.steps:
            return loop.Outcome(start.state, start.seconds, True)
        return loop.train(
            start.state,
            learner.sets["train"],
            network=learner.network,
            config=learner.config,
            checkpoints=checkpoints,
            log=log,
            evaluate=learner.validate,
            should_stop=job.agree_to_stop(stop.is_set),
            seconds=start.seconds,
            title=f"Training {workdir.name}",
            prepare=functools.partial(
                compile_predictor, learner.predictor, start.state, learner.config
            ),
            check=check_memory,
        )


def _restore_run(
    learner: Learner, checkpoints: Checkpoints, log: MetricLog, job: Job
) -> Restored:
    """The newest checkpoint that can be read, or step 0; the log is cut to fit."""
    restored = checkpoints.restore(describe_state(learner.network, learner.config))
    for step in restored.damaged if restored else ():
        print(f"The checkpoint of step {step} is damaged; the one before is used.")
    if restored:
        checkpoints.set_aside(restored.damaged)
        step = int(restored.state.step)
        print(f"Going on from the checkpoint of step {step}.", flush=True)
    else:
        restored = Restored(begin_run(learner.network, learner.config), 0.0, ())
    log.cut_after(int(restored.state.step))
    return restored


def begin_run(network: ShapePoseNetwork, config: Config) -> TrainState:
    """The state at step 0, on the run's devices.

    With `train.init_from` it has the parameters of the last checkpoint of that workdir.
    Optimiser, schedules and what was seen of the category begin anew.

    Raises:
      ValueError: where that workdir holds no checkpoint that can be read, or one of a
        network with other parameters.
    """
    state = init_state(network, config)
    if not config.train.init_from:
        return state
    workdir = Path(config.train.init_from)
    other = read_config(workdir)
    here = {
        "run": {"devices": config.run.devices},
        "train": {"models_per_batch": config.train.models_per_batch},
    }
    like = describe_state(make_network(other), replace_fields(other, here))
    sizes, found = (jax.tree.map(jnp.shape, s.params) for s in (state, like))
    if sizes != found:
        listed = list_differences(other, config)
        differing = [text for text in listed if text.startswith(_OF_NETWORK)]
        raise ValueError(
            "train.init_from must be the workdir of a run whose network has the same "
            f"parameters as this one's, but {workdir} differs in "
            f"{', '.join(differing)}; give another, or its values "
            "(--config.SECTION.FIELD=VALUE)."
        )
    last = restore_last(workdir / "checkpoints", like)
    print(f"Beginning with the parameters of {workdir}, step {int(last.step)}.")
    return state._replace(params=last.params)


def check_memory(program: jax.stages.Compiled) -> None:
    """Refuse a compiled step that the device's memory cannot hold, before it runs.

    Where the device does not tell its memory, as a CPU, nothing happens.

    Raises:
      ValueError: where the compiler's own layout needs more than there is.
    """
    limit = (jax.local_devices()[0].memory_stats() or {}).get("bytes_limit")
    layout = program.memory_analysis()
    if limit is None or layout is None:
        return
    needed = (
        layout.argument_size_in_bytes
        + layout.output_size_in_bytes
        + layout.temp_size_in_bytes
        - layout.alias_size_in_bytes
    )
    if needed > limit:
        raise ValueError(
            f"A training step must fit into the device's memory of {limit / _GB:.1f} "
            f"GB, but its program needs {needed / _GB:.1f} GB; set "
            "--config.render.renders_at_once=4 to render fewer views side by side, or "
            "--config.train.models_per_batch lower."
        )
