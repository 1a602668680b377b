"""The size of points: one sigma for all, or a learned one or covariance for each.

The rank of an array says which: () is a sigma that all points share, [N] a sigma of
each point, and [N, 3, 3] a covariance of each. A batch has one axis more, but for the
shared one.
"""

from collections.abc import Mapping

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import mass_of_peak, quaternion
from dpc_jax.render.projection import scale_sizes


def measure_points(
    shape: Mapping[str, jax.Array], *, grid: int
) -> tuple[jax.Array, jax.Array]:
    """(size, mass) of points of learned sizes, of B objects in a grid.

    The learned scale is here the peak height c_i of Eq. 3, whatever
    `render.scale_unit`: between the bounds of a size the masses that show at all span
    six powers of ten. A mass is c·(2π)^{3/2}·√|Σ|, so that a Gaussian that is thinner
    than a voxel fills its share of the cells and no more.

    A covariance is R·diag(s²)·Rᵀ of the widths and the turn of a point. A quaternion of
    any length makes seven numbers for six: overcomplete, as the paper says, but without
    the discontinuities of angles, and positive definite for all values.

    Args:
      shape: of `ShapeHead`. grid: side of the volume, in voxels.

    Returns:
      ([B, N] sigmas in voxels, or [B, N, 3, 3] covariances in voxels²; [B, N] voxels).
    """

    def make_covariance(widths, turn):
        # Entry by entry: as a matrix product of 3 × 3 it took longer on a CPU.
        scaled = quaternion.to_matrix(turn) * widths[None]
        return jnp.sum(scaled[:, None] * scaled[None], axis=-1)

    widths = grid * shape["sizes"]
    product = jnp.prod(jnp.broadcast_to(widths, (*widths.shape[:-1], 3)), axis=-1)
    mass = mass_of_peak(shape["scale"][:, None], jnp.ones(())) * product
    if "turns" not in shape:
        return widths[..., 0], mass
    return jax.vmap(jax.vmap(make_covariance))(widths, shape["turns"]), mass


def scale_point_sizes(
    size: jax.Array, mass: jax.Array, ratio: chex.Numeric
) -> tuple[jax.Array, jax.Array]:
    """`scale_sizes` of sizes of any rank, those of a batch too."""
    scaled, mass = map(jnp.asarray, scale_sizes(size, mass, ratio))
    is_covariance = jnp.ndim(size) > 2
    return (scaled * ratio if is_covariance else scaled), mass


def has_own_sizes(size: jax.Array) -> bool:
    """Whether every point has a size of its own."""
    return jnp.ndim(size) > 0
