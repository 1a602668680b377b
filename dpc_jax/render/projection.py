"""Differentiable projection of a point cloud: silhouette, depth and colour.

Section "Differentiable Point Clouds" of the paper: transform the points, fill a volume
with their densities, clip to occupancies, end each ray, project. Only what `signals`
names is computed.
"""

import chex
import jax.numpy as jnp

from dpc_jax.render import arguments, checks, termination, volume
from dpc_jax.render.camera import Camera, VoxelGrid

# Depth and colour of a ray that hits nothing (the released code's values).
BACKGROUND_DEPTH = 10.0
BACKGROUND_COLOR = 1.0


@chex.dataclass(frozen=True)
class Projection:
    """Images of a point cloud; None where not asked for.

    Attributes:
      silhouette: [rows, cols] in [0, 1].
      depth: [rows, cols], metric along z.
      color: [rows, cols, C].
    """

    silhouette: chex.Array | None = None
    depth: chex.Array | None = None
    color: chex.Array | None = None


def project(
    points: chex.Array,
    rotation: chex.Array,
    *,
    sigma: chex.Numeric | None = None,
    scale: chex.Numeric = 1.0,
    covariance: chex.Array | None = None,
    colors: chex.Array | None = None,
    translation: chex.Array | None = None,
    camera: Camera = Camera(),
    grid: VoxelGrid = VoxelGrid(64),
    signals: tuple[str, ...] = ("silhouette",),
    method: str = "auto",
    ray_rule: str = "termination",
    background_depth: chex.Numeric = BACKGROUND_DEPTH,
    background_color: chex.Numeric = BACKGROUND_COLOR,
) -> Projection:
    """Render one point cloud from one pose.

    Differentiable (in reverse mode) with respect to every array: points, rotation,
    sigma, scale, covariance, colors, translation, focal length, distance, background
    values.

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
        grid. The symmetric part counts.
      colors: [N, C], needed for the signal "color"; any number of channels.
      translation: [3], object to camera, after the rotation.
      camera: focal length, distance and kind of projection.
      grid: the volume, static.
      signals: any of "silhouette", "depth", "color"; static.
      method: "trilinear" (the paper's fast method: points to their eight neighbouring
        cells, then one smoothing), "gaussian" (its basic method: every point its own
        Gaussian, exact), or "auto", which takes "trilinear" for one shared sigma and
        "gaussian" for a sigma per point or a covariance; static.
      ray_rule: the silhouette of a ray, static: "termination" (1 - Π(1 - o), the
        paper's) or "maximum" (of its occupancies: Perspective Transformer Nets; equal
        maxima share the gradient). Depth and colour always end rays.
      background_depth: () depth of a ray that hits nothing.
      background_color: () or [C] colour of a ray that hits nothing.

    Returns:
      A `Projection` with the signals asked for.

    Raises:
      ValueError: for a wrong shape or dtype, an unknown signal, method or rule, colour
        asked without colours, and a method that cannot do what is asked.
    """
    points = arguments.convert_points(points)
    colors = None if colors is None else jnp.asarray(colors)
    arguments.check_signals(signals, ray_rule, points, colors)
    arguments.check_background(background_depth, background_color, colors)
    has_color = "color" in signals
    density, map_colors = _fill(
        points,
        rotation,
        sigma=sigma,
        scale=scale,
        covariance=covariance,
        colors=colors if has_color else None,
        translation=translation,
        camera=camera,
        grid=grid,
        method=method,
    )
    dtype = points.dtype
    occupancy = termination.clip_unit(density)
    silhouette = depth = color = None
    if "silhouette" in signals:
        is_product = ray_rule == "termination"
        silhouette = (
            termination.opacity(occupancy) if is_product else jnp.max(occupancy, -1)
        )
    if set(signals) == {"silhouette"}:
        return Projection(silhouette=silhouette)

    reached, background = termination.transmittance(occupancy)
    if "depth" in signals:
        # Float32 throughout, also where a GPU would round to TF32.
        depth = jnp.matmul(
            occupancy * reached, grid.depths(camera, dtype), precision="highest"
        ) + background * jnp.asarray(background_depth, dtype)
    if has_color:
        # Σ_k r_k·y_k with y = Σ y_i f_i / Σ f_i. With o = clip(Σ f_i), o·y is Σ y_i f_i
        # below the clip and y above it: no division by a density that may be as small
        # as floats go.
        weight = reached / jnp.where(density > 1, density, 1)
        channels = map_colors(lambda channel: jnp.sum(weight * channel, axis=-1))
        behind = jnp.asarray(background_color, dtype)
        color = jnp.moveaxis(channels, 0, -1) + background[..., None] * behind
    return Projection(silhouette=silhouette, depth=depth, color=color)


def voxelize(
    points: chex.Array,
    rotation: chex.Array,
    *,
    sigma: chex.Numeric | None = None,
    scale: chex.Numeric = 1.0,
    covariance: chex.Array | None = None,
    translation: chex.Array | None = None,
    camera: Camera = Camera(),
    grid: VoxelGrid = VoxelGrid(64),
    method: str = "auto",
) -> chex.Array:
    """Occupancies [rows, cols, depth] in [0, 1] that `project` ends its rays in.

    Arguments and errors as of `project`. `termination_probabilities` of the result are
    what ray-consistency losses (DRC) compare.
    """
    density, _ = _fill(
        arguments.convert_points(points),
        rotation,
        sigma=sigma,
        scale=scale,
        covariance=covariance,
        colors=None,
        translation=translation,
        camera=camera,
        grid=grid,
        method=method,
    )
    return termination.clip_unit(density)


def _fill(
    points,
    rotation,
    *,
    sigma,
    scale,
    covariance,
    colors,
    translation,
    camera,
    grid,
    method,
):
    """Check what places the points, and fill the volume in the points' dtype."""
    arguments.check_scene(sigma, scale, camera, grid)
    rotation = checks.convert("rotation", rotation)
    sigma, scale, covariance, translation = (
        None if value is None else jnp.asarray(value)
        for value in (sigma, scale, covariance, translation)
    )
    arguments.check_points(points, rotation, sigma, scale, covariance, translation)
    method = arguments.choose_method(method, sigma, covariance)

    def cast(array):
        return None if array is None else jnp.asarray(array, points.dtype)

    scene = volume.place_points(
        points,
        cast(rotation),
        sigma=cast(sigma),
        scale=cast(scale),
        covariance=cast(covariance),
        translation=cast(translation),
        camera=camera,
        grid=grid,
    )
    return volume.fill_volume(scene, cast(colors), shape=grid.shape, method=method)


def mass_of_peak(peak: chex.Numeric, sigma: chex.Numeric) -> chex.Array:
    """Mass in voxels of an isotropic Gaussian with peak height c (Eq. 4's c_i).

    scale = c·(2π)^{3/2}·σ³, with sigma in voxels.
    """
    sigma = jnp.asarray(sigma)
    # Factor by factor: σ³ alone may overflow where the mass does not.
    return jnp.asarray(peak) * (2 * jnp.pi) ** 1.5 * sigma * sigma * sigma
