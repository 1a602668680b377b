"""Occlusion along a ray: where each ray ends (section "Differentiable Point Clouds").

Products are taken as products: no logarithm, so a full cell is exactly full, an empty
ray is exactly empty, and both have the right gradient.
"""

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import checks


@jax.custom_jvp
def clip_unit(density: chex.Array) -> chex.Array:
    """Clip to [0, 1]: the occupancy o of the summed densities.

    The derivative at the two kinks is one, that of the inner side: most cells are
    exactly 0 and must be able to fill.
    """
    return jnp.clip(density, 0, 1)


@clip_unit.defjvp
def _clip_unit_jvp(primals, tangents):
    (density,), (tangent,) = primals, tangents
    passes = (density >= 0) & (density <= 1)
    return clip_unit(density), jnp.where(passes, tangent, 0)


def _union(first: chex.Array, second: chex.Array) -> chex.Array:
    """1 - (1 - a)(1 - b) as a sum of non-negative terms: no cancellation near 0."""
    return first + second * (1 - first)


def opacity(occupancy: chex.Array) -> chex.Array:
    """Probability that a ray ends in some cell, 1 - Π(1 - o_u): the silhouette.

    Built as a tree of unions a + b(1 - a), so a ray of occupancies 1e-9 keeps its
    digits in float32. Needs no termination probabilities.

    Args:
      occupancy: [..., D] in [0, 1], nearest cell first.

    Returns:
      [...] in [0, 1]. The gradient with respect to o_k is Π_{u≠k}(1 - o_u), right also
      where cells are exactly 0 or 1. Differentiated once more it is right where no cell
      is exactly 1.

    Raises:
      ValueError: for rays without cells, or another dtype.
    """
    return _opacity(_check_rays(occupancy))


@jax.custom_vjp
def _opacity(occupancy):
    while (size := occupancy.shape[-1]) > 1:
        half = size // 2
        pairs = _union(occupancy[..., :half], occupancy[..., half : 2 * half])
        rest = occupancy[..., 2 * half :]
        occupancy = jnp.concatenate([pairs, rest], -1) if rest.shape[-1] else pairs
    return occupancy[..., 0]


def _opacity_forward(occupancy):
    return _opacity(occupancy), occupancy


def _opacity_backward(occupancy, cotangent):
    transparency = 1 - occupancy
    is_full = transparency == 0
    num_full = jnp.sum(is_full, -1, keepdims=True)
    safe = jnp.where(is_full, 1, transparency)
    product = jnp.prod(safe, -1, keepdims=True)
    # Π of the others: all others are open (divide), or this is the only full cell, or
    # another cell is full.
    others = jnp.where(num_full == 0, product / safe, 0)
    others = jnp.where(is_full & (num_full == 1), product, others)
    return (others * cotangent[..., None],)


_opacity.defvjp(_opacity_forward, _opacity_backward)


def _check_rays(occupancy):
    occupancy = checks.check_array("occupancy", occupancy, (..., None))
    if occupancy.shape[-1] == 0:
        raise ValueError(
            "occupancy must have at least one cell along its last axis, but its shape "
            f"is {list(occupancy.shape)}; give rays [..., D]."
        )
    return occupancy


def transmittance(occupancy: chex.Array) -> tuple[chex.Array, chex.Array]:
    """Probability that a ray reaches each cell, Π_{u<k}(1 - o_u).

    Args:
      occupancy: [..., D] in [0, 1], nearest cell first.

    Returns:
      ([..., D], and [...] the probability that it passes them all, the background's).

    Raises:
      ValueError: as `opacity`.
    """
    occupancy = _check_rays(occupancy)
    passed = jnp.cumprod(1 - occupancy, axis=-1)
    before = jnp.concatenate([jnp.ones_like(passed[..., :1]), passed[..., :-1]], -1)
    return before, passed[..., -1]


def termination_probabilities(occupancy: chex.Array) -> tuple[chex.Array, chex.Array]:
    """Probability that a ray ends in each cell, r_k = o_k·Π_{u<k}(1 - o_u).

    Args:
      occupancy: [..., D] in [0, 1], nearest cell first.

    Returns:
      ([..., D] probabilities, [...] background Π(1 - o_u)); they are non-negative and
      sum to one.

    Raises:
      ValueError: as `opacity`.
    """
    occupancy = _check_rays(occupancy)
    before, background = transmittance(occupancy)
    return occupancy * before, background
