"""Points that hang alone in most shapes are given others' places. Not in the paper.

Where a point is, is a function of the image, but its part of the last layer is its own:
one that was pushed out of the images early hangs in the same place of every object.
Silhouettes tell it nothing there, repulsion holds it off. When training is done it gets
the weights of a point that lives.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding

from dpc_jax.config import Config
from dpc_jax.evaluation.chamfer import NEIGHBORS, REACH
from dpc_jax.learning import devices
from dpc_jax.learning.predictions import encode_views
from dpc_jax.learning.step import TrainState, describe_state
from dpc_jax.networks import ShapePoseNetwork

BATCHES = 8  # that points are looked at in
_PER_POINT = ("points", "colors", "sizes", "turns")  # layers of `ShapeHead`
_APART = 0.02  # standard deviation of a new point from its twin, before the tanh


def reseed_points(
    state: TrainState,
    batches: Iterable[Mapping[str, Any]],
    *,
    network: ShapePoseNetwork,
    config: Config,
) -> tuple[TrainState, int]:
    """The state without points that hang alone, and how many there were.

    Args:
      state: its buffers are donated.
      batches: of training views; a point hangs alone that does so in most of their
        shapes.
    """

    def measure(params, images, masks):
        images, masks = (a.reshape(-1, *a.shape[2:]) for a in (images, masks))
        features = encode_views(params, images, masks, network=network)
        shape: Any = network.apply(params, features, method="predict_shape")
        return measure_lone(shape["points"])

    def replace(state, dead):
        key = jax.random.fold_in(jax.random.key(config.seed % 2**32), state.step)
        choose, shift = jax.random.split(jax.random.fold_in(key, len(dead)))
        # Of each point the one whose weights it has: its own, or a living one's.
        logits = jnp.where(dead, -jnp.inf, 0.0)
        living = jax.random.categorical(choose, logits, shape=dead.shape)
        sources = jnp.where(dead, living, jnp.arange(len(dead)))
        params, optimizer = copy_points((state.params, state.optimizer), sources)
        # Two points at one place are one; trained on, they would never part.
        noise = _APART * jax.random.normal(shift, (len(dead), 3)) * dead[:, None]
        bias = params["params"]["shape"]["points"]["bias"]
        moved = bias + noise.reshape(-1).astype(bias.dtype)
        params["params"]["shape"]["points"]["bias"] = moved
        return state._replace(params=params, optimizer=optimizer)

    # Whole on every process, so that each decides the same.
    whole = NamedSharding(devices.make_mesh(config), devices.WHOLE)
    compiled = jax.jit(measure, out_shardings=whole)
    shares = [compiled(state.params, b["images"], b["masks"]) for b in batches]
    dead = np.mean([np.asarray(share) for share in shares], axis=0) > 0.5
    count = int(dead.sum())
    if not 0 < count < len(dead):
        return state, 0
    # Where the step's program, compiled ahead, has them.
    places = jax.tree.map(lambda a: a.sharding, describe_state(network, config))
    run = jax.jit(replace, donate_argnums=0, out_shardings=places)
    return run(state, dead), count


def measure_lone(clouds: jax.Array) -> jax.Array:
    """In what share [N] of clouds [B, N, 3] each point hangs alone (`stray_points`)."""

    def find_stray(points):
        # Axis by axis, so that the N² distances are counted and never stored.
        away = sum((axis[:, None] - axis[None]) ** 2 for axis in points.T)
        near = jnp.sum(away <= REACH**2, axis=1) - 1  # but itself
        return near < min(NEIGHBORS, len(points) - 1)

    return jnp.mean(jax.lax.map(find_stray, clouds), axis=0)


def copy_points(tree: Any, sources: jax.Array) -> Any:
    """Parameters, or their moments, in which point i has what point sources[i] had."""

    def take(path, leaf):
        keys = [getattr(key, "key", None) for key in path]
        if "shape" not in keys:
            return leaf
        if keys[-1] == "tint":
            return leaf[:, sources]
        if keys[-2] not in _PER_POINT:
            return leaf
        rows = leaf.reshape(*leaf.shape[:-1], len(sources), -1)
        return rows[..., sources, :].reshape(leaf.shape)

    return jax.tree_util.tree_map_with_path(take, tree)
