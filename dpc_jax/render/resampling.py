"""Trilinear samples of a volume at any place, with gradients to volume and places."""

import itertools

import jax
import jax.numpy as jnp

_IN_BOUNDS = "promise_in_bounds"


@jax.checkpoint
def sample_volume(volume: jax.Array, coordinates: jax.Array) -> jax.Array:
    """Values between the cells of a volume, zero beyond its rim.

    A cell is a tent: full at its centre, fading to zero at the centres of its
    neighbours, or at the same distance beyond the rim. The backward pass takes the
    samples again and keeps no corner.

    Args:
      volume: [X, Y, Z].
      coordinates: [..., 3] continuous index; cell i has its centre at i. Those that are
        not finite count as beyond the rim.

    Returns:
      [...]. The gradient with respect to the coordinates is that of the tents; on a
      cell's centre it is that towards the higher index.
    """
    shape = jnp.array(volume.shape)
    padded = jnp.pad(volume, 1).ravel()
    # Beyond the rim every sample reads padding, and has no gradient.
    is_near = jnp.all((coordinates > -1) & (coordinates < shape), axis=-1)
    safe = jnp.where(is_near[..., None], coordinates, 0)
    lower = jnp.floor(jax.lax.stop_gradient(safe))
    upper_share = safe - lower
    shares = jnp.stack([1 - upper_share, upper_share])  # [2, ..., 3]
    first = lower.astype(jnp.int32) + 1  # in the padded volume
    strides = (shape[1] + 2) * (shape[2] + 2), shape[2] + 2, 1
    total = jnp.zeros(is_near.shape, volume.dtype)
    for corner in itertools.product((0, 1), repeat=3):
        index, weight = jnp.zeros_like(first[..., 0]), jnp.ones((), volume.dtype)
        for axis, step in enumerate(corner):
            index += (first[..., axis] + step) * strides[axis]
            weight = weight * shares[step][..., axis]
        total += weight * padded.at[index].get(mode=_IN_BOUNDS)
    return jnp.where(is_near, total, 0)
