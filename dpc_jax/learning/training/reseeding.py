"""Points that hang alone in every shape begin anew where others live. Not in the paper.

Where a point is, is a function of the image, but its part of the last layer is its own:
one that was pushed out of the images early hangs in the same place of every object.
Silhouettes tell it nothing there, repulsion holds it off. It is given the weights of a
point that lives, and from there on both go their own ways.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from dpc_jax.config import Config
from dpc_jax.evaluation.stray_points import NEIGHBORS, REACH
from dpc_jax.learning.predictions import encode_views
from dpc_jax.learning.step import TrainState, describe_state
from dpc_jax.networks import ShapePoseNetwork

_SHARES = (0.5, 0.6, 0.7, 0.8, 0.9)  # of a run, after which points are looked at
_PER_POINT = ("points", "colors", "sizes", "turns")  # layers of `ShapeHead`
_APART = 0.02  # standard deviation of a new point from its twin, before the tanh

Reseed = Callable[[TrainState, Mapping[str, Any]], tuple[TrainState, jax.Array]]


def list_reseedings(config: Config) -> frozenset[int]:
    """The steps after which points are looked at."""
    if not config.train.reseeds_points or config.network.shape != "points":
        return frozenset()
    return frozenset(round(share * config.train.steps) for share in _SHARES)


def make_reseed(network: ShapePoseNetwork, config: Config) -> Reseed:
    """A compiled function (state, batch) -> (state, () how many points began anew).

    It gives the old state's memory to the new one, and is a function of the run's seed
    and the step alone beside them.
    """

    def reseed(state: TrainState, batch: Mapping[str, Any]):
        features = encode_views(state.params, batch["images"], network=network)
        flat = features.reshape(-1, features.shape[-1])
        shape: Any = network.apply(state.params, flat, method="predict_shape")
        dead = find_dead(shape["points"])
        key = jax.random.fold_in(jax.random.key(batch["seeds"][0]), state.step)
        choose, shift = jax.random.split(jax.random.fold_in(key, len(dead)))
        sources = choose_sources(choose, dead)
        params, optimizer = take_points((state.params, state.optimizer), sources)
        params = _move_apart(shift, params, sources)
        count = jnp.sum(sources != jnp.arange(len(dead)))
        return state._replace(params=params, optimizer=optimizer), count

    # Where the step's program, compiled ahead, has them.
    like = describe_state(network, config)
    places = jax.tree.map(lambda leaf: leaf.sharding, like)
    return jax.jit(reseed, donate_argnums=0, out_shardings=(places, None))


def find_dead(clouds: jax.Array) -> jax.Array:
    """Which points [N] hang alone in more than half of clouds [B, N, 3].

    Alone is what `evaluation.stray_points` counts, by the same distance.
    """

    def find_stray(points):
        away = jnp.sum((points[:, None] - points[None]) ** 2, axis=-1)
        near = jnp.sum(away <= REACH**2, axis=1) - 1  # but itself
        return near < min(NEIGHBORS, len(points) - 1)

    return jnp.mean(jax.lax.map(find_stray, clouds), axis=0) > 0.5


def choose_sources(key: jax.Array, dead: jax.Array) -> jax.Array:
    """Of each point [N] the one whose weights it has: its own, or a living one's.

    Where none lives all stay as they are.
    """
    own = jnp.arange(len(dead))
    logits = jnp.where(dead, -jnp.inf, 0.0)
    living = jax.random.categorical(key, logits, shape=dead.shape)
    return jnp.where(dead & ~jnp.all(dead), living, own)


def take_points(tree: Any, sources: jax.Array) -> Any:
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


def _move_apart(key, params, sources):
    """Twins at the same place would have the same gradient for good."""
    is_new = sources != jnp.arange(len(sources))
    noise = _APART * jax.random.normal(key, (len(sources), 3)) * is_new[:, None]

    def move(path, leaf):
        keys = [getattr(key, "key", None) for key in path]
        is_bias = "shape" in keys and keys[-2:] == ["points", "bias"]
        return leaf + noise.reshape(-1).astype(leaf.dtype) if is_bias else leaf

    return jax.tree_util.tree_map_with_path(move, params)
