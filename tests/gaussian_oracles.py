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
