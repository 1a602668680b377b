"""Differentiable projection of a point cloud: silhouette, depth and colour.

Section "Differentiable Point Clouds" of the paper, by its fast method: transform the
points, splat them on a grid, smooth, clip to occupancies, end each ray, project.
Only what `signals` names is computed.
"""

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import smoothing, splatting, termination
from dpc_jax.render.camera import Camera, VoxelGrid, to_camera_frame, to_grid

SIGNALS = ("silhouette", "depth", "color")
METHODS = ("auto", "trilinear")
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
    sigma: chex.Numeric,
    scale: chex.Numeric = 1.0,
    covariance: chex.Array | None = None,
    colors: chex.Array | None = None,
    translation: chex.Array | None = None,
    camera: Camera = Camera(),
    grid: VoxelGrid = VoxelGrid(64),
    signals: tuple[str, ...] = ("silhouette",),
    method: str = "auto",
    background_depth: chex.Numeric = BACKGROUND_DEPTH,
    background_color: chex.Numeric = BACKGROUND_COLOR,
) -> Projection:
    """Render one point cloud from one pose.

    Args:
      points: [N, 3], object frame; float. Their dtype decides that of the result.
      rotation: [4] quaternion wxyz or [3, 3] matrix, object to camera.
      sigma: (), standard deviation of the points' Gaussian, in voxels.
      scale: () or [N], mass of a point in voxels. `mass_of_peak` converts the paper's
        peak height c.
      covariance: not yet supported; must be None.
      colors: [N, C], needed for the signal "color".
      translation: [3], object to camera, after the rotation.
      camera: focal length, distance and kind of projection.
      grid: the volume, static.
      signals: any of "silhouette", "depth", "color"; static.
      method: "trilinear" (the paper's fast method), or "auto", which takes it.
      background_depth: () depth of a ray that hits nothing.
      background_color: () or [C] colour of a ray that hits nothing.

    Returns:
      A `Projection` with the signals asked for.

    Raises:
      ValueError: for a wrong shape or dtype, an unknown signal or method, colour asked
        without colours, and arguments not yet supported.
    """
    points, rotation, scale = (jnp.asarray(a) for a in (points, rotation, scale))
    colors = None if colors is None else jnp.asarray(colors)
    translation = None if translation is None else jnp.asarray(translation)
    background_color = jnp.asarray(background_color)
    _check_arguments(
        points, rotation, sigma, scale, covariance, colors, translation, signals, method
    )
    _check_background(background_depth, background_color, colors)
    dtype = points.dtype
    sigma, scale = jnp.asarray(sigma, dtype), jnp.asarray(scale, dtype)
    moved = to_camera_frame(
        points, rotation.astype(dtype), translation=translation, camera=camera
    )
    coordinates, is_inside = to_grid(moved, camera=camera, grid=grid)
    mass = jnp.where(is_inside, scale, 0)

    density = smoothing.smooth(splatting.splat(coordinates, mass, grid.shape), sigma)
    occupancy = termination.clip_unit(density)
    if tuple(signals) == ("silhouette",):
        return Projection(silhouette=termination.opacity(occupancy))

    reached, background = termination.transmittance(occupancy)
    silhouette = depth = color = None
    if "silhouette" in signals:
        silhouette = termination.opacity(occupancy)
    if "depth" in signals:
        # Float32 throughout, also where a GPU would round to TF32.
        depth = jnp.matmul(
            occupancy * reached,
            grid.depths(camera, dtype),
            precision=jax.lax.Precision.HIGHEST,
        ) + background * jnp.asarray(background_depth, dtype)
    if "color" in signals:
        color = _project_colors(
            coordinates, mass, jnp.asarray(colors, dtype), sigma, density, reached
        ) + background[..., None] * jnp.asarray(background_color, dtype)
    return Projection(silhouette=silhouette, depth=depth, color=color)


def _project_colors(coordinates, mass, colors, sigma, density, reached):
    """Σ_k r_k·y_k with y = Σ y_i f_i / Σ f_i.

    With o = clip(Σ f_i), o·y is Σ y_i f_i below the clip and y above it: no division by
    a density that may be as small as floats go.
    """
    shape = density.shape
    weight = reached / jnp.where(density > 1, density, 1)
    channels = [
        jnp.sum(
            weight
            * smoothing.smooth(
                splatting.splat(coordinates, mass * channel, shape), sigma
            ),
            axis=-1,
        )
        for channel in colors.T
    ]
    return jnp.stack(channels, axis=-1)


def mass_of_peak(peak: chex.Numeric, sigma: chex.Numeric) -> chex.Array:
    """Mass in voxels of an isotropic Gaussian with peak height c (Eq. 4's c_i).

    scale = c·(2π)^{3/2}·σ³, with sigma in voxels.
    """
    return jnp.asarray(peak) * (2 * jnp.pi) ** 1.5 * jnp.asarray(sigma) ** 3


def _check_arguments(
    points, rotation, sigma, scale, covariance, colors, translation, signals, method
):
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(
            f"points must have shape [N, 3], but they have {list(points.shape)}; use "
            "jax.vmap or jax.lax.map over a batch of clouds."
        )
    if not jnp.issubdtype(points.dtype, jnp.floating):
        raise ValueError(
            f"points must be floating point numbers, but they are {points.dtype}; "
            "convert them with points.astype('float32')."
        )
    if rotation.shape not in ((4,), (3, 3)):
        raise ValueError(
            "rotation must be a quaternion [4] or a matrix [3, 3], but it has shape "
            f"{list(rotation.shape)}; use jax.vmap over several poses."
        )
    if covariance is not None:
        raise ValueError(
            "covariance must be None, because full covariances are not yet supported, "
            "but an array came; pass a shared sigma instead."
        )
    if sigma is None or jnp.ndim(sigma) != 0:
        came = "None" if sigma is None else f"shape {list(jnp.shape(sigma))}"
        raise ValueError(
            "sigma must be one number in voxels, because a sigma per point is not yet "
            f"supported, but {came} came; pass a scalar."
        )
    if jnp.shape(scale) not in ((), points.shape[:1]):
        raise ValueError(
            f"scale must be one number or [N] = [{points.shape[0]}], but it has shape "
            f"{list(jnp.shape(scale))}; pass a scalar or one value per point."
        )
    if translation is not None and jnp.shape(translation) != (3,):
        raise ValueError(
            "translation must have shape [3], but it has "
            f"{list(jnp.shape(translation))}; use jax.vmap over several poses."
        )
    if isinstance(signals, str) or not signals or set(signals) - set(SIGNALS):
        raise ValueError(
            f"signals must be a non-empty tuple with any of {SIGNALS}, but it is "
            f"{signals!r}; write for example signals=('silhouette',)."
        )
    if method not in METHODS:
        raise ValueError(
            f"method must be one of {METHODS}, but it is {method!r}; the Gaussian "
            "method is not yet supported."
        )
    if "color" in signals and colors is None:
        raise ValueError(
            "the signal 'color' needs colors of shape [N, C], but colors is None; pass "
            "them or leave 'color' out of signals."
        )
    if colors is not None and (
        jnp.ndim(colors) != 2
        or jnp.shape(colors)[0] != points.shape[0]
        or jnp.shape(colors)[1] == 0
    ):
        raise ValueError(
            f"colors must have shape [N, C] with N = {points.shape[0]} and C >= 1, but "
            f"they have {list(jnp.shape(colors))}; give one row per point."
        )


def _check_background(background_depth, background_color, colors):
    if jnp.ndim(background_depth) != 0:
        raise ValueError(
            "background_depth must be one number, but it has shape "
            f"{list(jnp.shape(background_depth))}; pass a scalar."
        )
    channels = () if colors is None else jnp.shape(colors)[1:]
    if jnp.shape(background_color) not in ((), channels):
        raise ValueError(
            f"background_color must be one number or [C] = {list(channels)} like the "
            f"colors, but it has shape {list(jnp.shape(background_color))}; pass one "
            "value per channel."
        )
