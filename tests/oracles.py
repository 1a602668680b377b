"""The written equations in float64 numpy, with loops; shares no code with dpc_jax."""

import math

import numpy as np
from scipy.spatial.transform import Rotation


def splat(coordinates, values, shape):
    """Trilinear splatting, point by point and corner by corner."""
    volume = np.zeros(shape)
    for point, value in zip(np.asarray(coordinates, float), values, strict=True):
        if any(not -0.5 <= p <= s - 0.5 for p, s in zip(point, shape, strict=True)):
            continue
        for i in range(shape[0]):
            for j in range(shape[1]):
                for k in range(shape[2]):
                    weight = 1.0
                    for p, cell in zip(point, (i, j, k), strict=True):
                        weight *= max(0.0, 1.0 - abs(p - cell))
                    volume[i, j, k] += value * weight
    return volume


def smooth(volume, sigma):
    """Direct sum over all cells with the kernel normalised over the integers."""
    if sigma == 0:
        return np.array(volume)
    reach = int(50 * sigma) + 2
    total = math.fsum(
        math.exp(-0.5 * (k / sigma) ** 2) for k in range(-reach, reach + 1)
    )
    result = np.array(volume, float)
    for axis, size in enumerate(volume.shape):
        kernel = [
            [math.exp(-0.5 * ((a - b) / sigma) ** 2) / total for b in range(size)]
            for a in range(size)
        ]
        result = np.moveaxis(np.tensordot(kernel, result, axes=(1, axis)), 0, axis)
    return result


def termination(occupancy):
    """(r_k [..., D], background [...]) cell by cell along the last axis."""
    probabilities = np.zeros_like(occupancy)
    passed = np.ones(occupancy.shape[:-1])
    for k in range(occupancy.shape[-1]):
        probabilities[..., k] = occupancy[..., k] * passed
        passed = passed * (1 - occupancy[..., k])
    return probabilities, passed


def place(
    points,
    rotation,
    *,
    shape,
    focal_length=1.875,
    distance=2.0,
    extent=1.0,
    translation=None,
    orthographic=False,
):
    """Continuous (row, col, depth) index [N, 3] of points of the object."""
    rotation = np.asarray(rotation, float)
    if rotation.shape == (4,):
        rotation = Rotation.from_quat(rotation, scalar_first=True).as_matrix()
    moved = np.asarray(points, float) @ rotation.T
    if translation is not None:
        moved = moved + translation
    x, y, z = moved[:, 0], moved[:, 1], moved[:, 2] + distance
    if orthographic:
        u, v = x, y
    else:
        u, v = focal_length * x / z, focal_length * y / z
    rows, cols, depth = shape
    return np.stack(
        [
            (v / extent + 0.5) * rows - 0.5,
            (u / extent + 0.5) * cols - 0.5,
            ((z - distance) / extent + 0.5) * depth - 0.5,
        ],
        axis=-1,
    )


def project(
    points,
    rotation,
    *,
    sigma,
    scale,
    shape,
    focal_length=1.875,
    distance=2.0,
    extent=1.0,
    translation=None,
    colors=None,
    orthographic=False,
    background_depth=10.0,
    background_color=1.0,
    fill=None,
):
    """Silhouette, depth and colour of a cloud as the conventions write them.

    `fill` makes a volume of coordinates [N, 3] and values [N]; by default the fast
    method's.
    """
    if fill is None:
        fill = lambda where, what: smooth(splat(where, what, shape), sigma)  # noqa: E731
    coordinates = place(
        points,
        rotation,
        shape=shape,
        focal_length=focal_length,
        distance=distance,
        extent=extent,
        translation=translation,
        orthographic=orthographic,
    )
    depth = shape[2]
    masses = np.broadcast_to(scale, len(points))
    density = fill(coordinates, masses)
    probabilities, background = termination(np.clip(density, 0, 1))
    depths = distance + ((np.arange(depth) + 0.5) / depth - 0.5) * extent
    images = {
        "silhouette": 1 - background,
        "depth": probabilities @ depths + background * background_depth,
        "termination": probabilities,
    }
    if colors is not None:
        channels = []
        for channel in np.asarray(colors, float).T:
            weighted = fill(coordinates, masses * channel)
            mean = np.divide(
                weighted, density, out=np.zeros_like(density), where=density > 0
            )
            channels.append((probabilities * mean).sum(-1))
        images["color"] = (
            np.stack(channels, -1) + background[..., None] * background_color
        )
    return images
