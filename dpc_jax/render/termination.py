"""Occlusion along a ray: where each ray ends (Eq. 4).

Products are computed as products, not as sums of logarithms. So the transmittance is
exactly zero behind an occupancy of one, exactly one along an empty ray, and both have
the right gradient.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.render import checks


def opacity(occupancy: jax.Array) -> jax.Array:
    """Probability that a ray ends in some cell, 1 - Π(1 - o_u).

    This is the silhouette: Eq. 5 with y = 1 in the volume and 0 behind it, in closed
    form. Built as a tree of unions 1 - (1 - a)(1 - b) = a + b(1 - a): with terms
    >= 0 nothing cancels, and a ray of occupancies 1e-9 is accurate in float32.

    Args:
      occupancy: [..., D] in [0, 1], nearest cell first.

    Returns:
      [...] in [0, 1]. The gradient with respect to o_k is Π_{u≠k}(1 - o_u), even where
      cells are exactly 0 or 1. Second derivatives are right where no cell is exactly 1.

    Raises:
      ValueError: for rays without cells, or another dtype.

    Example:
      >>> float(dpc_jax.opacity(jnp.array([0.5, 0.5])))
      0.75
    """
    return _opacity(_check_rays(occupancy))


@jax.custom_vjp
def _opacity(occupancy):
    while (size := occupancy.shape[-1]) > 1:
        half = size // 2
        near, far = occupancy[..., :half], occupancy[..., half : 2 * half]
        pairs = near + far * (1 - near)
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
    # Π over the other cells: divide where no cell is full; where this is the only full
    # cell, the product over the rest is already there; otherwise it is zero.
    others = jnp.where(num_full == 0, product / safe, 0)
    others = jnp.where(is_full & (num_full == 1), product, others)
    return (others * cotangent[..., None],)


_opacity.defvjp(_opacity_forward, _opacity_backward)


@jax.custom_vjp
def fullest(occupancy: jax.Array) -> jax.Array:
    """The largest occupancy of each ray, [..., D] to [...]; equal ones share its slope.

    `jnp.max` finds in its backward pass again which cells equal the maximum. Where XLA
    computes the two apart, they may differ by rounding, and then no cell does: under
    `jax.vmap` a volume's gradient came out wrong by a tenth, or as NaN.
    """
    return jnp.max(occupancy, -1)


def _fullest_forward(occupancy):
    return fullest(occupancy), occupancy


def _fullest_backward(occupancy, cotangent):
    peak = jnp.max(occupancy, -1, keepdims=True)
    is_peak = occupancy >= peak
    # Found by index, which no rounding can miss.
    first = jnp.argmax(occupancy, -1)
    is_peak |= jax.nn.one_hot(first, occupancy.shape[-1], dtype=bool)
    shares = is_peak / jnp.sum(is_peak, -1, keepdims=True)
    return (shares.astype(occupancy.dtype) * cotangent[..., None],)


fullest.defvjp(_fullest_forward, _fullest_backward)


def _check_rays(occupancy):
    occupancy = checks.check_array("occupancy", occupancy, (..., None))
    if occupancy.shape[-1] == 0:
        raise ValueError(
            "occupancy must have at least one cell along its last axis, but its shape "
            f"is {list(occupancy.shape)}; give rays [..., D]."
        )
    return occupancy


class Rays(NamedTuple):
    """Probabilities of where rays end."""

    ends: jax.Array  # [..., D], r_k, that a ray ends in cell k
    background: jax.Array  # [...], r_{D+1}, that it passes all cells
    reached: jax.Array  # [..., D], Π_{u<k}(1 - o_u), that it reaches cell k


def end_rays(occupancy: jax.Array) -> Rays:
    """Eq. 4 of the paper: ray termination, r_k = o_k·Π_{u<k}(1 - o_u)."""
    occupancy = _check_rays(occupancy)
    passed = jnp.cumprod(1 - occupancy, axis=-1)
    reached = jnp.concatenate([jnp.ones_like(passed[..., :1]), passed[..., :-1]], -1)
    return Rays(occupancy * reached, passed[..., -1], reached)


def termination_probabilities(occupancy: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Ray termination probabilities, r_k = o_k·Π_{u<k}(1 - o_u) (Eq. 4).

    Arguments and errors as of `opacity`.

    Returns:
      ([..., D] probabilities r_k, [...] background r_{D+1} = Π(1 - o_u)); they are
      non-negative and sum to one.

    Example:
      >>> shares, background = dpc_jax.termination_probabilities(jnp.array([0.5, 0.5]))
      >>> shares.tolist(), float(background)
      ([0.5, 0.25], 0.25)
    """
    rays = end_rays(occupancy)
    return rays.ends, rays.background
