"""The training of a run: its first or last saved state, then steps until the end."""

import contextlib
import functools
from pathlib import Path

import jax
import jax.numpy as jnp

from dpc_jax.config import Config, replace_fields
from dpc_jax.learning.inference.predictor import compile_predictor
from dpc_jax.learning.step import TrainState, describe_state, init_state
from dpc_jax.learning.training import loop
from dpc_jax.learning.training.checkpoints import Checkpoints, Restored
from dpc_jax.learning.training.records import MetricLog
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.run.hosts.agreement import Job
from dpc_jax.run.hosts.writing import open_checkpoints, restore_last
from dpc_jax.run.learner import Learner
from dpc_jax.run.process import catch_signals
from dpc_jax.run.setup import make_network
from dpc_jax.run.workdir import list_differences, read_config

# Fields that the shapes of parameters depend on.
_OF_NETWORK = (
    *("network.", "pose.", "render.num_points", "render.grid", "render.scale_fixed"),
    *("train.color_weight", "train.colors_move_points", "data.image_size"),
)
_GB = 1e9


def train_learner(
    learner: Learner, workdir: Path, log: MetricLog, job: Job
) -> loop.Outcome:
    """Train to the last step, or until SIGTERM or Ctrl-C asks to save and stop.

    Args:
      log: that records are written to.
    """
    checkpoints = open_checkpoints(workdir / "checkpoints", job)
    views = {split: int(data.counts.sum()) for split, data in learner.sets.items()}
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
            may_stop_waiting=job.processes == 1,
            seconds=start.seconds,
            title=f"Training {workdir.name}",
            validations_after=(views["test"] + views["val"]) / views["val"],
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
