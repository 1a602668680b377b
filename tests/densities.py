"""Continuous Gaussian densities in float64, also exactly projected; no code shared."""

import numpy as np


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
