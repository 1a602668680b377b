"""The whole projection in long double numpy, from the written equations."""

import numpy as np

from dpc_jax.measure.stability.cases import oracles


def render(
    points,
    rotation,
    sigma,
    scale,
    colors,
    *,
    shape,
    focal=1.875,
    distance=2.0,
    background=(10.0, 1.0),
    covariance_of=None,
    is_exact=False,
):
    """(silhouette, depth, color [rows, cols, C]) of one cloud.

    Args:
      is_exact: every point its own Gaussian, else trilinear weights and one smoothing.
      covariance_of: None, or a function (points, rotation, sigma) -> [N, 3, 3] in the
        grid; then sigma is what it makes them from.
    """
    coordinates, is_inside = oracles.place(
        points, rotation, focal=focal, distance=distance, shape=shape
    )
    masses = np.where(is_inside, scale * np.ones(len(points)), 0)

    def fill(values):
        if covariance_of is not None:
            matrices = covariance_of(points, rotation, sigma)
            return oracles.sum_covariances(coordinates, values, matrices, shape)
        if is_exact:
            sigmas = sigma * np.ones(len(points))
            return oracles.sum_gaussians(coordinates, values, sigmas, shape)
        return oracles.smooth(oracles.splat(coordinates, values, shape), sigma)

    density = fill(masses)
    channels = [fill(masses * colors[:, c]) for c in range(colors.shape[1])]
    return project_volumes(density, channels, shape, distance, background)


def project_volumes(density, channels, shape, distance, background):
    """End the rays of densities Σ f and Σ y·f, and take depth and colour from them."""
    occupancy = oracles.clip(density)
    probabilities, passed = oracles.terminate(occupancy)
    cells = (np.arange(shape[2]) + oracles.REAL(0.5)) / shape[2] - oracles.REAL(0.5)
    far, behind = background
    depth = np.sum(probabilities * (cells + distance), axis=-1) + passed * far
    # r·y with y = Σ y_i f_i / Σ f_i; where Σ f is zero, its limit: o/Σ f is one.
    before = oracles.find_transparencies(occupancy)[..., :-1]
    is_over = np.real(density) > 1
    share = np.where(is_over, 1 / np.where(is_over, density, 1), 1)
    color = [
        np.sum(before * share * channel, axis=-1) + passed * behind
        for channel in channels
    ]
    return np.sum(probabilities, axis=-1), depth, np.stack(color, axis=-1)


def move_covariances(points, rotation, covariances, *, shape, focal, distance):
    """S·J·R·Σ·Rᵀ·Jᵀ·S written out, with J of u = f·x/z, v = f·y/z and z."""
    turned = oracles.rotate(points, rotation)
    axes = oracles.rotate(np.eye(3), rotation).T  # columns: where the axes go
    moved = []
    for (x, y, z), matrix in zip(turned, covariances, strict=True):
        ahead = z + distance
        slopes = np.array(
            [
                [0 * ahead, focal / ahead, -focal * y / (ahead * ahead)],
                [focal / ahead, 0 * ahead, -focal * x / (ahead * ahead)],
                [0 * ahead, 0 * ahead, 1 + 0 * ahead],
            ]
        )
        linear = (np.array(shape)[:, None] / oracles.REAL(shape[0])) * _multiply(
            slopes, axes
        )
        symmetric = (matrix + matrix.T) / 2
        moved.append(_multiply(_multiply(linear, symmetric), linear.T))
    return np.array(moved).reshape(-1, 3, 3)


def _multiply(a, b):
    return np.sum(a[:, :, None] * b[None], axis=1)
