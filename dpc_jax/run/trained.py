"""The network of a run, read back from its workdir to ask it for shapes."""

import dataclasses
import functools
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.config import Config, replace_fields
from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import Alignment, align_points, identity_alignment
from dpc_jax.learning.framing import make_inputs
from dpc_jax.learning.step import TrainState, describe_state
from dpc_jax.learning.training.checkpoints import restore_last
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.run.setup import load_set, make_data_specs, make_network
from dpc_jax.run.workdir import read_alignment, read_config


class TrainedNetwork(NamedTuple):
    """What a run has learned, at its last checkpoint."""

    config: Config
    network: ShapePoseNetwork
    state: TrainState
    alignment: Alignment  # from the network's frame to the object frame


def load_trained(workdir: Path, *, cache_dir: str = "") -> TrainedNetwork:
    """The network of the finished run of a workdir, on one device.

    Args:
      cache_dir: of its data; that of the run where it is empty.

    Raises:
      ValueError: where the workdir holds no finished run, or it cannot be read.
    """
    changes: dict = {"run": {"devices": 1}}
    if cache_dir:
        changes["data"] = {"cache_dir": cache_dir}
    config = replace_fields(read_config(workdir), changes)
    if read_alignment(workdir) is None:
        raise ValueError(
            f"Expected a finished run in {workdir}, of data with true poses, but it "
            "has no report/alignment.json; start the command that began the run again, "
            "or take another run."
        )
    return load_checkpoint(config, workdir)


def load_checkpoint(config: Config, workdir: Path) -> TrainedNetwork:
    """The network at the last checkpoint of a run, on the devices of the config.

    Without an alignment its own frame counts as that of the objects.
    """
    network = make_network(config)
    state = restore_last(workdir / "checkpoints", describe_state(network, config))
    alignment = read_alignment(workdir) or identity_alignment()
    return TrainedNetwork(config, network, state, alignment)


def load_split(trained: TrainedNetwork, split: str, **changes: Any) -> DataSet:
    """The split "val" or "test" of a run's data, from its cache or prepared now.

    Args:
      changes: fields of its `DataSpec` that are to be others.
    """
    spec = dataclasses.replace(make_data_specs(trained.config)[split], **changes)
    return load_set(trained.config, spec)


def predict_points(
    trained: TrainedNetwork,
    images: np.ndarray,
    masks: np.ndarray,
    *,
    mix: np.ndarray | None = None,
) -> np.ndarray:
    """Clouds [n, N, 3] in the object frame of images uint8 [n, S, S, 3] with masks.

    All at once: a thousand images of 64 pixels take 0.5 GB. With the weights `mix`
    [M, n] they are the clouds [M, N, 3] of mixtures of the images, see `ImageEncoder`.
    """
    weights = None if mix is None else jnp.asarray(mix, jnp.float32)
    params, network = trained.state.params, trained.network
    points = _decode(params, images, masks, weights, network=network)
    return align_points(trained.alignment, np.asarray(points))


@functools.partial(jax.jit, static_argnames="network")
def _decode(params, images, masks, mix, *, network):
    inputs = make_inputs(images, masks, network=network)
    features = network.apply(params, inputs, mix=mix, method="encode")
    return network.apply(params, features, method="predict_shape")["points"]
