"""Gaussians drawn as shaded ellipsoids: one ray per pixel, without any 3D library."""

import numpy as np
from numpy.typing import ArrayLike

from dpc_jax.reporting.spheres import view_points

# How many standard deviations from its centre a Gaussian's surface is drawn.
DEVIATIONS = 1.5
_LIGHT = np.array([-0.45, 0.65, 0.62])  # from the upper left, towards right, up, viewer
_BACKGROUND = np.ones(3)


def draw_ellipsoids(
    points: ArrayLike,
    covariances: ArrayLike,
    colors: ArrayLike,
    *,
    view_deg: tuple[float, float],
    side: int = 320,
    half_width: float = 0.6,
) -> np.ndarray:
    """A picture [side, side, 3] in [0, 1] of Gaussians, orthographic, z up.

    The nearest surface that a pixel's ray meets is shown, shaded as if lit from the
    upper left.

    Args:
      points: [N, 3], object frame. covariances: [N, 3, 3], in squares of its unit.
      colors: [N, 3] in [0, 1].
      view_deg: azimuth and elevation of the viewer, as of `spheres.view_points`.
      half_width: of the picture, in units of the object.
    """
    axes = view_points(np.eye(3), view_deg)  # columns: right, up, towards the viewer
    centers = view_points(np.asarray(points), view_deg)
    turned = np.einsum("ji,njk,kl->nil", axes, np.asarray(covariances, float), axes)
    # A variance of exactly zero has no surface.
    turned += 1e-9 * np.eye(3)
    shades = np.asarray(colors, float)
    light = _LIGHT / np.linalg.norm(_LIGHT)
    place = (np.arange(side) + 0.5) / side * 2 - 1
    right, up = np.meshgrid(half_width * place, -half_width * place)
    nearest = np.full((side, side), -np.inf)
    picture = np.broadcast_to(_BACKGROUND, (side, side, 3)).copy()
    for center, covariance, color in zip(centers, turned, shades, strict=True):
        depth, normals = _meet(right - center[0], up - center[1], covariance)
        depth = depth + center[2]
        is_seen = depth > nearest  # NaN, where the ray passes by, is not
        lit = 0.35 + 0.65 * np.clip(normals[is_seen] @ light, 0, 1)
        picture[is_seen] = lit[:, None] * color
        nearest[is_seen] = depth[is_seen]
    return np.clip(picture, 0, 1)


def _meet(right, up, covariance):
    """Where rays first meet the surface: depth [...] (NaN: never) and normals.

    The surface is xᵀ·A·x = k² with A the inverse covariance, a quadratic in the depth.
    """
    a = np.linalg.inv(covariance)
    linear = a[0, 2] * right + a[1, 2] * up
    rest = a[0, 0] * right**2 + 2 * a[0, 1] * right * up + a[1, 1] * up**2
    square = linear**2 - a[2, 2] * (rest - DEVIATIONS**2)
    root = np.sqrt(np.where(square >= 0, square, np.nan))
    depth = (root - linear) / a[2, 2]
    normals = np.stack([right, up, depth], axis=-1) @ a
    return depth, normals / np.linalg.norm(normals, axis=-1, keepdims=True)
