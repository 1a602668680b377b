"""Differentiable projection of a point cloud: silhouette, depth and colour.

Section "Differentiable Point Clouds" of the paper, in its order: transform T_c
(`place_points`), occupancy by Eq. 3 (`fill_volume`), ray termination by Eq. 4
(`end_rays`), projection by Eq. 5 (`project_signals`). Only what `signals` names is
computed.
"""

import functools
import math
from collections.abc import Callable

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import arguments, termination
from dpc_jax.render.blocks import capacity
from dpc_jax.render.blocks.rays import render_blocks
from dpc_jax.render.camera import Camera, VoxelGrid
from dpc_jax.render.volume import clip_unit, fill_volume, place_points

# Arguments that a program is compiled for; all others are its inputs.
STATIC = ("grid", "signals", "method", "ray_rule", "max_blocks")


@chex.dataclass(frozen=True)
class Projection:
    """Images of a point cloud; None where not asked for.

    Attributes:
      silhouette: [rows, cols] in [0, 1].
      depth: [rows, cols], metric along z.
      color: [rows, cols, C].
      termination: [rows, cols, depth], probability r_k that a ray ends in each cell,
        nearest first (Eq. 4).
      background: [rows, cols], probability that it passes all of them, r_{D+1}; comes
        with the termination, with which it sums to one.
    """

    silhouette: jax.Array | None = None
    depth: jax.Array | None = None
    color: jax.Array | None = None
    termination: jax.Array | None = None
    background: jax.Array | None = None


def project(
    points: jax.Array,
    rotation: jax.Array,
    *,
    sigma: chex.Numeric | None = None,
    scale: chex.Numeric = 1.0,
    covariance: jax.Array | None = None,
    colors: jax.Array | None = None,
    translation: jax.Array | None = None,
    camera: Camera = Camera(),
    grid: VoxelGrid = VoxelGrid(64),
    signals: tuple[str, ...] = ("silhouette",),
    method: str = "auto",
    ray_rule: str = "termination",
    background_depth: chex.Numeric = 10.0,
    background_color: chex.Numeric = 1.0,
    max_blocks: int | None = None,
) -> Projection:
    """Render one point cloud from one camera pose.

    Differentiable in reverse mode with respect to every array: points, rotation, sigma,
    scale, covariance, colors, translation, focal length, distance, background values.
    Reverse mode twice gives second derivatives, of the method "trilinear" alone.

    Numbers that are known, outside of `jax.jit`, `jax.grad` and `jax.vmap`, are
    checked. Traced ones cannot be: a point that is not finite, or that its pose makes
    so, is left out; the zero quaternion turns nothing, a matrix is applied as it is,
    and a negative sigma or variance counts as 0; a negative scale takes away from other
    points, and a sigma or scale that is NaN makes NaN images.

    Args:
      points: [N, 3], object frame; float. Their dtype decides that of the result.
      rotation: [4] quaternion wxyz or [3, 3] matrix, object to camera.
      sigma: () or [N], standard deviation of a point's Gaussian in voxels of the grid;
        None with a covariance.
      scale: () or [N], mass of a point in voxels. `mass_of_peak` converts the paper's
        peak height c.
      covariance: [N, 3, 3], of each point in the object frame, in voxels², where a
        voxel is extent / rows long. It turns with the object and perspective zooms it
        (`move_covariance` says what is approximated); sigma, in contrast, is in the
        grid. Only the symmetric part is used.
      colors: [N, C], needed for the signal "color"; any number of channels.
      translation: [3], object to camera, after the rotation.
      camera: focal length, distance and kind of projection.
      grid: the volume, static.
      signals: any of "silhouette", "depth", "color", "termination"; static.
      method: "trilinear" (the paper's fast method: points to their eight neighbouring
        cells, then one smoothing), "quadratic" and "cubic" (to 27 and 64 cells by
        B-splines: for a sigma from 1 voxel on their gradient with respect to points is
        within 6 and 2 % of the exact one), "gaussian" (the paper's basic method: every
        point its own Gaussian, exact), or "auto", which takes "trilinear" for one
        shared sigma and "gaussian" for a sigma per point or a covariance; static.
      ray_rule: the silhouette of a ray, static: "termination" (1 - Π(1 - o), the
        paper's) or "maximum" (of its occupancies: Perspective Transformer Nets; equal
        maxima share the gradient). Depth and colour always take Eq. 4.
      background_depth, background_color: () depth and () or [C] colour of a ray that
        hits nothing; the defaults are the released code's.
      max_blocks: room for so many blocks of 8³ cells; static, for one shared sigma.
        Only blocks that the points and their smoothing touch are then stored: the same
        images and gradients to rounding, in a time and memory that follow `max_blocks`
        instead of the grid (docs/projection.md says where that is quicker).
        `count_blocks` counts those of a cloud. Where a cloud touches more, or sigma is
        so wide that the smoothing reaches beyond the next block (above 1.4 voxels,
        1.2 for "cubic", 0.9 in float64), the whole volume steps in up to 256³ cells;
        images of a larger grid are NaN. The signal "termination" and the rule
        "maximum" always take the whole volume. None: blocks are counted where all
        numbers are known (outside of `jax.jit`, `jax.grad` and `jax.vmap`) and the grid
        has at least 128³ cells; otherwise the whole volume is stored. Inside `jax.vmap`
        both are computed up to 256³ cells; `project_batch` on a CPU takes one example
        after the other.

    Returns:
      `Projection`: silhouette and depth [rows, cols], color [rows, cols, C],
      termination [rows, cols, depth] with the background [rows, cols]; None for what
      is not in signals.

    Raises:
      ValueError: for a wrong shape or dtype, an unknown signal, method or rule, colour
        asked without colours, a method that cannot do what is asked, max_blocks below 1
        or with a size per point, a grid that does not fit into memory, and known
        numbers that make no image: points, sizes, poses or a camera that are not
        finite, a quaternion of zeros, a matrix that is no rotation, a negative size,
        eigenvalue or focal length.

    Example:
      >>> points = 0.2 * jax.random.normal(jax.random.key(0), (500, 3))
      >>> image = dpc_jax.project(points, jnp.eye(3), sigma=1.5).silhouette
      >>> image.shape
      (64, 64)
    """
    arguments.check_signals(signals, ray_rule, has_colors=colors is not None)
    scene = place_points(
        points, rotation, sigma, scale, covariance, translation, camera, grid, method
    )
    background = background_depth, background_color
    colors = arguments.convert_colors(colors, scene.mass.shape, background)
    colors = colors if "color" in signals else None
    is_whole = ray_rule == "maximum" or "termination" in signals
    room = None
    if max_blocks is not None or not is_whole:  # a wrong max_blocks is refused
        room = capacity.choose_room(scene, grid.shape, max_blocks)
    if room is None or is_whole:
        filled = fill_volume(scene, colors, grid.shape)
        return project_signals(*filled, camera, grid, signals, ray_rule, background)
    return _project_in_blocks(
        scene, colors, camera, background, grid, tuple(signals), room
    )


@functools.partial(jax.jit, static_argnums=(4, 5, 6))
def _project_in_blocks(scene, colors, camera, background, grid, signals, max_blocks):
    """In blocks where they do, else the whole volume; NaN where that is large.

    One program, where all operations would run one by one.
    """
    images, is_right = render_blocks(
        scene, colors, camera, grid, signals, background, max_blocks
    )
    in_blocks = Projection(**images)
    if math.prod(grid.shape) > capacity.SMALL_UP_TO:
        return jax.tree.map(lambda x: jnp.where(is_right, x, jnp.nan), in_blocks)

    # What either branch keeps for its gradient comes out of both: nothing is kept of
    # the whole volume, which is filled again.
    @jax.checkpoint
    def project_whole():
        filled = fill_volume(scene, colors, grid.shape)
        rule = "termination"
        return project_signals(*filled, camera, grid, signals, rule, background)

    return jax.lax.cond(is_right, lambda: in_blocks, project_whole)


def project_signals(
    density: jax.Array,
    map_colors: Callable | None,
    camera: Camera,
    grid: VoxelGrid,
    signals: tuple[str, ...],
    ray_rule: str,
    background: tuple[chex.Numeric, chex.Numeric],
) -> Projection:
    """Eq. 5 of the paper: p = Σ_k r_k·y_k along each ray, the background included.

    y_k is 1 for a silhouette (0 in the background), the depth z_k, or a colour; the
    background has a depth and a colour. The densities and map_colors are those of
    `fill_volume`, the other arguments as in `project`.
    """
    background_depth, background_color = background
    occupancy, dtype = clip_unit(density), density.dtype
    images = {}
    if "silhouette" in signals:
        is_product = ray_rule == "termination"
        combine = termination.opacity if is_product else termination.fullest
        images["silhouette"] = combine(occupancy)
    if set(signals) == {"silhouette"}:
        return Projection(**images)

    rays = termination.end_rays(occupancy)
    if "termination" in signals:
        images |= {"termination": rays.ends, "background": rays.background}
    if "depth" in signals:
        # In the points' dtype, also where a GPU would round float32 to TF32.
        images["depth"] = jnp.matmul(
            rays.ends, grid.depths(camera, dtype), precision="highest"
        ) + rays.background * jnp.asarray(background_depth, dtype)
    if map_colors is not None:
        behind = jnp.asarray(background_color, dtype).reshape(1, 1, -1)
        # o·y without a division by a density that may be as small as floats go: below
        # the clip it is Σ y_i·f_i, above it Σ y_i·f_i / Σ f_i.
        weight = _divide(rays.reached, jnp.where(density > 1, density, 1))
        channels = map_colors(lambda channel: jnp.sum(weight * channel, axis=-1))
        colors = jnp.moveaxis(channels, 0, -1)
        images["color"] = colors + rays.background[..., None] * behind
    return Projection(**images)


@jax.custom_jvp
def _divide(total, density):
    """A quotient whose derivative squares no density: 1e30 has no square in float32."""
    return total / density


@_divide.defjvp
def _divide_jvp(primals, tangents):
    total, density = primals
    quotient = total / density
    return quotient, (tangents[0] - quotient * tangents[1]) / density


def voxelize(
    points: jax.Array,
    rotation: jax.Array,
    *,
    sigma: chex.Numeric | None = None,
    scale: chex.Numeric = 1.0,
    covariance: jax.Array | None = None,
    translation: jax.Array | None = None,
    camera: Camera = Camera(),
    grid: VoxelGrid = VoxelGrid(64),
    method: str = "auto",
) -> jax.Array:
    """The occupancy grid [rows, cols, depth], in [0, 1], that `project` traces.

    Arguments and errors as in `project`. Ray-consistency losses (DRC) compare the
    `termination_probabilities` of the result.

    Returns:
      [rows, cols, depth] occupancies.

    Example:
      >>> dpc_jax.voxelize(jnp.zeros((1, 3)), jnp.eye(3), sigma=1.0).shape
      (64, 64, 64)
    """
    scene = place_points(
        points, rotation, sigma, scale, covariance, translation, camera, grid, method
    )
    return clip_unit(fill_volume(scene, None, grid.shape)[0])


def mass_of_peak(peak: chex.Numeric, sigma: chex.Numeric) -> jax.Array:
    """Mass in voxels of an isotropic Gaussian with peak height c (the c_i in Eq. 3).

    scale = c·(2π)^{3/2}·σ³, with sigma in voxels. The peak is that of the density, not
    of its samples, which sum to the mass for every sigma: below a sigma of half a voxel
    a point on a cell's centre fills the cell by less than c, at 0.2 by c/8.

    Returns:
      The mass, of the shape that peak and sigma have together.

    Example:
      >>> round(float(dpc_jax.mass_of_peak(1.0, 1.0)), 2)
      15.75
    """
    sigma = jnp.asarray(sigma)
    # Factor by factor: σ³ alone may overflow where the mass does not.
    return jnp.asarray(peak) * (2 * jnp.pi) ** 1.5 * sigma * sigma * sigma
