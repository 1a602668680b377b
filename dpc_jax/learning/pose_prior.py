"""A prior on the distribution of poses, by a judge that learns against it (MVC).

Without it the heads of MVC may agree on one side of the object. The judge tells
predicted poses from poses drawn as the views were: azimuths uniform, elevations uniform
in their range, no roll (Goodfellow et al., 2014; Tulsiani et al., 2018).
"""

import functools
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import optax

from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.networks.viewpoints import face_object


def judge_poses(
    params: Mapping,
    quaternions: jax.Array,
    keys: jax.Array,
    *,
    network: ShapePoseNetwork,
) -> tuple[jax.Array, jax.Array]:
    """What predicted poses lose, and what the judge loses.

    Both are cross entropies in nats. The first has no gradient by the judge, the second
    none by the poses.

    Args:
      params: of the network, the judge's among them.
      quaternions: [B, V, 4], of any length but zero. keys: [B], of the objects.

    Returns:
      ([B·V], ()).
    """
    views = quaternions.shape[1]
    own = jax.vmap(functools.partial(jax.random.fold_in, data=2))(keys)
    assert network.viewpoints is not None  # heads of MVC
    draw = functools.partial(_draw, views=views, elevations=network.viewpoints)
    drawn, signs = jax.vmap(draw)(own)
    length = jnp.linalg.norm(quaternions, axis=-1, keepdims=True)
    # q and -q are one pose: neither sign may give it away.
    predicted = (signs * quaternions / length).reshape(-1, 4)

    def judge(params, poses):
        logits = network.apply(params, poses, method="judge_poses")
        assert isinstance(logits, jax.Array)
        return logits

    losses = _cross_entropy(judge(jax.lax.stop_gradient(params), predicted), 1.0)
    found = _cross_entropy(judge(params, jax.lax.stop_gradient(predicted)), 0.0)
    right = _cross_entropy(judge(params, drawn.reshape(-1, 4)), 1.0)
    return losses, jnp.mean(found) + jnp.mean(right)


def _draw(key, *, views, elevations):
    """Poses [V, 4] by the prior, and random signs [V, 1] for the predicted ones."""
    azimuths, heights, signs, others = jax.random.split(key, 4)
    low, high = (jnp.deg2rad(angle) for angle in elevations)
    poses = face_object(
        jax.random.uniform(azimuths, (views,), maxval=2 * jnp.pi),
        jax.random.uniform(heights, (views,), minval=low, maxval=high),
    )
    own = jax.random.rademacher(signs, (views, 1), jnp.float32)
    return own * poses, jax.random.rademacher(others, (views, 1), jnp.float32)


def _cross_entropy(logits, label):
    return optax.losses.sigmoid_binary_cross_entropy(
        logits, jnp.full_like(logits, label)
    )
