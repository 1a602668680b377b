"""The first state of a run: from its seed alone, or with another run's parameters."""

import contextlib
from pathlib import Path

import jax

from dpc_jax.config import Config, from_json, replace_fields, to_json
from dpc_jax.learning.step import TrainState, describe_state, init_state
from dpc_jax.learning.training.checkpoints import Checkpoints
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.run.hosts.agreement import Job
from dpc_jax.run.hosts.checkpoints import SharedCheckpoints
from dpc_jax.run.setup import make_network
from dpc_jax.run.workdir import list_differences, read_config

# Fields that make_network reads.
_OF_NETWORK = (
    *("network.", "pose.", "render.num_points", "render.grid", "render.scale_fixed"),
    *("train.color_weight", "data.image_size"),
)


def begin_run(network: ShapePoseNetwork, config: Config, job: Job) -> TrainState:
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
    # Only process 0 has to see the folder.
    text = job.do_first(lambda: to_json(read_config(workdir)))
    other = from_json(job.gather(text or "")[0])
    here = {
        "run": {"devices": config.run.devices},
        "train": {"models_per_batch": config.train.models_per_batch},
    }
    like = describe_state(make_network(other), replace_fields(other, here))
    if _measure(like.params) != _measure(state.params):
        differing = [
            text
            for text in list_differences(other, config)
            if text.startswith(_OF_NETWORK)
        ]
        raise ValueError(
            "train.init_from must be the workdir of a run whose network has the same "
            f"parameters as this one's, but {workdir} differs in "
            f"{', '.join(differing)}; give another, or its values "
            "(--config.SECTION.FIELD=VALUE)."
        )
    found = _restore(workdir / "checkpoints", like, job)
    print(f"Beginning with the parameters of {workdir}, step {int(found.step)}.")
    return state._replace(params=found.params)


def _measure(params):
    """The parameters' names and shapes."""
    return jax.tree.map(lambda a: (a.shape, a.dtype), params)


def _restore(folder, like, job):
    def check():
        if not folder.is_dir():
            raise ValueError(_say_missing(folder))

    job.do_first(check)
    is_shared = job.processes > 1
    checkpoints = SharedCheckpoints(folder, job) if is_shared else Checkpoints(folder)
    with contextlib.closing(checkpoints):
        try:
            found = checkpoints.restore(like)
        except ValueError:  # whose advice is for a run's own folder
            raise ValueError(
                "Expected a whole checkpoint of the run of train.init_from in "
                f"{folder}, but none of them could be read; give the workdir of "
                "another run."
            ) from None
    if found is None:
        raise ValueError(_say_missing(folder))
    return found.state


def _say_missing(folder):
    return (
        f"Expected a checkpoint of the run of train.init_from in {folder}, but there "
        "is none; give the workdir of a run that has saved one."
    )
