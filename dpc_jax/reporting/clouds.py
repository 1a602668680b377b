"""Point clouds as pictures of shaded spheres or ellipsoids, drawn with NumPy alone."""

import numpy as np
from numpy.typing import ArrayLike

FRONT = (35.0, 25.0)  # azimuth, elevation in degrees: front and left, from above
REAR = (-130.0, 20.0)  # back and right side
_RADIUS = 0.012  # of the spheres of 2000 points, object units
_REACH = 0.54  # of the picture from its middle, object units: box diagonal 1 fits in
_FINER = 2  # times finer than asked for, then averaged: smooth edges
# From the upper left, towards the viewer: right, up, nearness.
_LIGHT = np.array([-0.45, 0.6, 0.66]) / np.linalg.norm([-0.45, 0.6, 0.66])
_DEPTH = 0.8  # from the farthest to the nearest that colours tell apart
_FADE = 0.45  # how far the colour of what is farthest fades to white
_NEAR, _FAR = np.array([0.10, 0.29, 0.55]), np.array([0.62, 0.75, 0.88])
# How many standard deviations from its centre a Gaussian's surface is drawn.
DEVIATIONS = 1.5
HALF_WIDTH, _SIDE = 0.6, 320  # of their picture, object units and pixels


def view_points(points: np.ndarray, view_deg: tuple[float, float]) -> np.ndarray:
    """Points [N, 3] as right, up and nearness [N, 3] for a viewer.

    Orthographic, z up. The view is azimuth and elevation in degrees; azimuth 0 looks at
    the front (from +x), 90 at the left (from +y).
    """
    azimuth, elevation = np.radians(view_deg)
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    toward = np.cos(elevation) * level + np.sin(elevation) * np.array([0.0, 0.0, 1.0])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(toward, right)
    return np.asarray(points, np.float64) @ np.stack([right, up, toward], axis=1)


def shade_depth(points: ArrayLike, view_deg: tuple[float, float]) -> np.ndarray:
    """Colours [N, 3] of 0 to 1 that tell how near points [N, 3] are: dark is near."""
    near = _find_nearness(view_points(np.asarray(points), view_deg))
    return _FAR + (_NEAR - _FAR) * near


def draw_cloud(
    points: ArrayLike,
    colors: ArrayLike | None = None,
    *,
    view_deg: tuple[float, float] = FRONT,
    radius: ArrayLike | None = None,
    size: int = 320,
) -> np.ndarray:
    """Picture uint8 [size, size, 3] of points as spheres, on white, orthographic.

    Args:
      points: [N, 3] in the object frame (z up). What lies outside is cut off.
      colors: [N, 3] of 0 to 1; None for depth.
      view_deg: azimuth and elevation, as of `view_points`.
      radius: of the spheres in object units, one or [N]; None: the smaller the more
        there are.
      size: of the picture's side, pixels.
    """
    cloud = np.asarray(points, np.float64)
    if radius is None:
        radius = _RADIUS * np.clip(np.sqrt(2000 / max(len(cloud), 1)), 0.5, 3.0)
    paint = shade_depth(cloud, view_deg) if colors is None else colors
    seen = view_points(cloud, view_deg)
    order = np.argsort(seen[:, 2], kind="stable")  # painter's order: far first
    seen = seen[order]
    radii = np.broadcast_to(np.asarray(radius, float), len(seen))[order]
    # The far ones fade, as in the other pictures of clouds.
    fade = _FADE * (1.0 - _find_nearness(seen))
    faded = np.clip(np.asarray(paint, float), 0.0, 1.0)[order]
    faded = faded + (1.0 - faded) * fade

    side = _FINER * size
    scale = side / (2 * _REACH)  # pixels in an object unit
    pixels, shades = _cover_pixels(seen, faded, radii, scale, side)
    picture = np.ones((side * side, 3), np.float32)
    picture[pixels] = shades  # of several for one pixel the last one stays: the nearest
    fine = picture.reshape(size, _FINER, size, _FINER, 3).mean(axis=(1, 3))
    return np.rint(255 * fine).astype(np.uint8)


def _find_nearness(seen):
    """0 (far) to 1 (near) [N, 1] of seen points, on a fixed scale."""
    return np.clip(seen[:, 2:] / _DEPTH + 0.5, 0.0, 1.0)


def _cover_pixels(seen, colors, radii, scale, side):
    """Pixel and colour of every place that the spheres cover, one after the other."""
    reach = max(1, int(np.ceil(radii.max() * scale)))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, 1, -1)
    pixel_radii = np.maximum(radii * scale, 1.0)[:, None]
    square = (x**2 + y**2) / pixel_radii**2
    cols = np.floor(seen[:, :1] * scale + side / 2).astype(int) + x
    rows = np.floor(side / 2 - seen[:, 1:2] * scale).astype(int) + y
    covered = (cols >= 0) & (cols < side) & (rows >= 0) & (rows < side) & (square <= 1)

    which, place = np.nonzero(covered)
    towards = np.sqrt(1.0 - square[covered])
    across = np.stack([x[0, place], -y[0, place]]) / pixel_radii[which, 0]
    lit = _LIGHT[:2] @ across + _LIGHT[2] * towards
    shade = (0.55 + 0.45 * np.maximum(lit, 0.0))[:, None]
    return (rows * side + cols)[covered], colors[which] * shade


def draw_ellipsoids(
    points: ArrayLike,
    covariances: ArrayLike,
    colors: ArrayLike,
    *,
    view_deg: tuple[float, float],
) -> np.ndarray:
    """A picture [320, 320, 3] in [0, 1] of Gaussians, orthographic, z up.

    The nearest surface that a pixel's ray meets is shown, shaded as if lit from the
    upper left.

    Args:
      points: [N, 3], object frame. covariances: [N, 3, 3], in squares of its unit.
      colors: [N, 3] in [0, 1].
      view_deg: azimuth and elevation of the viewer, as of `view_points`.
    """
    axes = view_points(np.eye(3), view_deg)  # columns: right, up, towards the viewer
    centers = view_points(np.asarray(points), view_deg)
    turned = np.einsum("ji,njk,kl->nil", axes, np.asarray(covariances, float), axes)
    # A variance of exactly zero has no surface.
    turned += 1e-9 * np.eye(3)
    place = HALF_WIDTH * ((np.arange(_SIDE) + 0.5) / _SIDE * 2 - 1)
    right, up = np.meshgrid(place, -place)
    nearest, picture = np.full((_SIDE, _SIDE), -np.inf), np.ones((_SIDE, _SIDE, 3))
    shades = np.asarray(colors, float)
    for center, covariance, color in zip(centers, turned, shades, strict=True):
        depth, normals = _meet(right - center[0], up - center[1], covariance)
        depth = depth + center[2]
        is_seen = depth > nearest  # NaN, where the ray passes by, is not
        lit = 0.35 + 0.65 * np.clip(normals[is_seen] @ _LIGHT, 0, 1)
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
