"""The whole projection written out in long double numpy."""

from collections.abc import Callable

import numpy as np

from dpc_jax.measure.stability.cases import oracles
from dpc_jax.measure.stability.cases.case import REAL
from dpc_jax.measure.stability.cases.oracles import Array

FOCAL, DISTANCE = 1.875, 2.0
BACKGROUND = (10.0, 1.0)  # depth and colour, the defaults of `dpc_jax.project`


def render(
    points: Array,
    rotation: Array,
    sigma: oracles.Number,
    scale: oracles.Number,
    colors: Array,
    *,
    shape: oracles.Shape,
    is_exact: bool = False,
    covariance_of: Callable | None = None,
) -> tuple[Array, Array, Array]:
    """(silhouette, depth, color [rows, cols, C]) of one cloud before the background.

    See `dpc_jax.project`. There is a Gaussian for each point if `is_exact`, or with the
    covariances in the grid, `covariance_of(points, rotation, sigma)` [N, 3, 3]; else
    trilinear weights and one smoothing.
    """
    scene = (points, rotation, FOCAL, DISTANCE)
    coordinates, is_inside = oracles.place(*scene, shape=shape)
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
    return _end_rays(density, channels)


def _end_rays(density, channels, distance: oracles.Number = DISTANCE):
    """Silhouette, depth and colour from the densities Σ f and Σ y·f."""
    occupancy = oracles.clip(density)
    probabilities, passed = oracles.terminate(occupancy)
    num_cells = density.shape[2]
    cells = (np.arange(num_cells) + REAL(0.5)) / num_cells - REAL(0.5)
    far, behind = BACKGROUND
    depth = np.sum(probabilities * (cells + distance), axis=-1) + passed * far
    # r·y with y = Σ y_i f_i / Σ f_i. Up to density 1 the factor o / Σ f is one, also in
    # the limit of no density.
    before = oracles.find_transparencies(occupancy)[..., :-1]
    is_over = np.real(density) > 1
    share = np.where(is_over, 1 / np.where(is_over, density, 1), 1)
    color = [
        np.sum(before * share * channel, axis=-1) + passed * behind
        for channel in channels
    ]
    return np.sum(probabilities, axis=-1), depth, np.stack(color, axis=-1)


def render_cells(
    volume: Array,
    colors: Array,
    rotation: Array,
    translation: Array,
    focal: oracles.Number,
    distance: oracles.Number,
    *,
    shape: oracles.Shape,
    orthographic: bool = False,
) -> tuple[Array, Array, Array]:
    """(silhouette, depth, color [rows, cols, C]) of occupancies of the object frame.

    See `dpc_jax.project_volume`: at every cell of the grid the tents of all cells.
    """
    rows, cols, depths = shape
    v, u, z = (
        part.ravel()
        for part in np.meshgrid(
            *((np.arange(n) + REAL(0.5)) / n - REAL(0.5) for n in shape), indexing="ij"
        )
    )
    ahead = z + distance
    is_ahead = np.ones(len(z), bool) if orthographic else np.real(ahead) > 1e-6
    zoom = 1 if orthographic else np.where(is_ahead, ahead, 1) / focal
    moved = np.stack([u * zoom, v * zoom, z], axis=-1) - translation
    axes = oracles.rotate(np.eye(3), rotation)  # row i: where axis i goes
    turned = np.sum(moved[:, None, :] * axes, axis=-1)
    weights = [
        _find_tents((turned[:, axis] + REAL(0.5)) * size - REAL(0.5), size)
        for axis, size in enumerate(volume.shape)
    ]

    def sample(cells):
        x, y, z = weights
        spread = x[:, :, None, None] * y[:, None, :, None] * z[:, None, None, :]
        values = np.sum(spread * cells, axis=(1, 2, 3))
        return np.where(is_ahead, values, 0).reshape(rows, cols, depths)

    density = sample(volume)
    channels = [sample(volume * colors[..., c]) for c in range(colors.shape[-1])]
    return _end_rays(density, channels, distance)


def _find_tents(places, size):
    """Weights [n, size] of the cells at each place, none beyond a cell from the rim."""
    away = places[:, None] - np.arange(size)
    real = np.real(away)
    is_inside = (np.real(places) > -1) & (np.real(places) < size)
    # At a kink, the side towards the higher index.
    is_near = (real >= -1) & (real < 1) & is_inside[:, None]
    return np.where(is_near, np.where(real >= 0, 1 - away, 1 + away), 0)


def move_covariances(
    points: Array, rotation: Array, covariances: Array, *, shape: oracles.Shape
) -> Array:
    """S·J·R·Σ·Rᵀ·Jᵀ·S written out, where J is the Jacobian of (f·y/z, f·x/z, z)."""
    turned = oracles.rotate(points, rotation)
    axes = oracles.rotate(np.eye(3), rotation).T  # columns: where the axes go
    moved = []
    for (x, y, z), matrix in zip(turned, covariances, strict=True):
        ahead = z + DISTANCE
        slopes = np.array(
            [
                [0 * ahead, FOCAL / ahead, -FOCAL * y / (ahead * ahead)],
                [FOCAL / ahead, 0 * ahead, -FOCAL * x / (ahead * ahead)],
                [0 * ahead, 0 * ahead, 1 + 0 * ahead],
            ]
        )
        stretch = np.array(shape)[:, None] / REAL(shape[0])
        linear = stretch * _multiply(slopes, axes)
        symmetric = (matrix + matrix.T) / 2
        moved.append(_multiply(_multiply(linear, symmetric), linear.T))
    return np.array(moved).reshape(-1, 3, 3)


def _multiply(a, b):
    return np.sum(a[:, :, None] * b[None], axis=1)
