"""The basic method in float64 numpy, point by point; shares no code with dpc_jax."""

import numpy as np


def _weights(cells, center, sigma, reach=80):
    """One axis, normalised over a long stretch of the integers."""
    wide = np.arange(cells[0] - reach, cells[-1] + reach + 1)
    if sigma == 0:
        nearest = np.abs(wide - center)
        full = (nearest == nearest.min()).astype(float)
    else:
        exponent = -0.5 * ((wide - center) / sigma) ** 2
        full = np.exp(exponent - exponent.max())
    return (full / full.sum())[reach : reach + len(cells)]


def sum_gaussians(coordinates, values, sigmas, shape):
    """[V, rows, cols, depth] of isotropic Gaussians."""
    volume = np.zeros((values.shape[1], *shape))
    for point, value, sigma in zip(coordinates, values, sigmas, strict=True):
        row, col, depth = (
            _weights(np.arange(size), x, sigma)
            for x, size in zip(point, shape, strict=True)
        )
        block = row[:, None, None] * col[:, None] * depth
        volume += value[:, None, None, None] * block
    return volume


def sum_densities(coordinates, values, covariances, shape):
    """[V, rows, cols, depth] of the continuous densities at the cell centres."""
    cells = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    volume = np.zeros((values.shape[1], *shape))
    for point, value, matrix in zip(coordinates, values, covariances, strict=True):
        away = cells - point
        square = np.einsum("...i,ij,...j->...", away, np.linalg.inv(matrix), away)
        peak = 1 / np.sqrt((2 * np.pi) ** 3 * np.linalg.det(matrix))
        volume += value[:, None, None, None] * peak * np.exp(-square / 2)
    return volume


def moments(volume):
    """Mass, mean [3] and covariance [3, 3] of a volume."""
    cells = np.stack(np.meshgrid(*map(np.arange, volume.shape), indexing="ij"), -1)
    mass = volume.sum()
    mean = np.einsum("abc,abci->i", volume, cells) / mass
    away = cells - mean
    return mass, mean, np.einsum("abc,abci,abcj->ij", volume, away, away) / mass


def linearise(function, point, step=1e-5):
    """Jacobian [3, 3] of a map of one point, by central differences."""
    sides = [
        (function(point + step * axis) - function(point - step * axis)) / (2 * step)
        for axis in np.eye(3)
    ]
    return np.stack(sides, axis=-1)


def project_density(places, matrix, centre, focal_length):
    """What a Gaussian before a camera becomes in the image: exactly, not linearised.

    Args:
      places: [..., 3], (v, u, z) with u = focal·x/z, v = focal·y/z.
      matrix, centre: [3, 3] covariance and [3] mean of (x, y, z).

    Returns:
      [...] density over (v, u, z), by the change of variables dx·dy = (z/focal)²·du·dv.
    """
    v, u, z = np.moveaxis(places, -1, 0)
    away = np.stack([u * z / focal_length, v * z / focal_length, z], -1) - centre
    square = np.einsum("...i,ij,...j->...", away, np.linalg.inv(matrix), away)
    peak = 1 / np.sqrt((2 * np.pi) ** 3 * np.linalg.det(matrix))
    return np.where(z > 0, peak * np.exp(-square / 2) * (z / focal_length) ** 2, 0)


def compare_with_linear(matrix, centre, focal_length, linear):
    """How far an exact projected Gaussian is from one with the covariance `linear`.

    Sums over a lattice of 0.2 standard deviations out to six: right to 1e-6, but for
    what of a very wide point lies behind the camera.

    Returns:
      Share of the mass in the wrong place (total variation); offset of the mean in
      standard deviations of a pixel axis; relative difference of the covariances.
    """
    steps = np.linspace(-6, 6, 61)
    lattice = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1)
    root = np.linalg.cholesky(linear)
    x, y, z = centre
    middle = np.array([focal_length * y / z, focal_length * x / z, z])
    places = middle + lattice @ root.T
    cell = (steps[1] - steps[0]) ** 3
    expected = np.exp(-0.5 * (lattice**2).sum(-1)) / (2 * np.pi) ** 1.5 * cell
    exact = project_density(places, matrix, centre, focal_length)
    exact = exact * np.linalg.det(root) * cell
    mean = np.einsum("abc,abci->i", exact, places) / exact.sum()
    away = places - mean
    found = np.einsum("abc,abci,abcj->ij", exact, away, away) / exact.sum()
    deviations = np.sqrt(np.diag(linear))[:2]
    return (
        0.5 * np.abs(exact - expected).sum(),
        np.abs((mean - middle)[:2] / deviations).max(),
        np.linalg.norm(found - linear) / np.linalg.norm(linear),
    )
