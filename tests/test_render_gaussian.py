"""The basic method: every point its own Gaussian, isotropic or with a covariance."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.render import kernels
from dpc_jax.render.exact import covariances, factoring, gaussians

SHAPE = (11, 20, 9)  # neither cubic nor a multiple of a tile's side


@functools.partial(jax.jit, static_argnames="shape")
def fill(coordinates, values, sigma, shape=SHAPE):
    return gaussians.sum_gaussians(coordinates, values, sigma, shape=shape)


def test_a_point_of_size_zero_falls_on_the_nearest_cell_and_a_tie_is_shared():
    coordinates = np.array([[3.4, 5.0, 6.0], [3.0, 7.5, 2.0]], "f4")
    volume = np.asarray(fill(coordinates, np.ones((2, 1), "f4"), np.zeros(2, "f4")))[0]
    assert volume[3, 5, 6] == 1
    assert volume[3, 7, 2] == 0.5 and volume[3, 8, 2] == 0.5
    assert np.count_nonzero(volume) == 3


def test_a_well_sampled_covariance_gives_the_continuous_density():
    rng = np.random.default_rng(0)
    coordinates = np.array(SHAPE) * rng.uniform(-0.1, 1.1, (30, 3))
    values = rng.normal(size=(30, 2))
    half = rng.normal(size=(30, 3, 3)) * rng.uniform(0.3, 2, (30, 1, 1))
    matrices = half @ half.transpose(0, 2, 1) + 0.7 * np.eye(3)
    with jax.enable_x64(True):
        sum_points = functools.partial(covariances.sum_covariances, shape=SHAPE)
        volume = jax.jit(sum_points)(coordinates, values, matrices)
    cells = np.stack(np.meshgrid(*map(np.arange, SHAPE), indexing="ij"), axis=-1)
    expected = np.zeros((2, *SHAPE))
    for point, value, matrix in zip(coordinates, values, matrices, strict=True):
        density = find_density(cells - point, matrix)
        expected += value[:, None, None, None] * density
    # Aliasing of the thinnest, 2·exp(-2π²·0.7) = 2e-6 of a density of at most 0.05.
    np.testing.assert_allclose(volume, expected, atol=3e-7)


def find_density(away, matrix):
    """Of a continuous Gaussian, at distances [..., 3] from its mean."""
    square = np.einsum("...i,ij,...j->...", away, np.linalg.inv(matrix), away)
    return np.exp(-square / 2) / np.sqrt((2 * np.pi) ** 3 * np.linalg.det(matrix))


@jax.jit
@functools.partial(jax.value_and_grad, argnums=(0, 1))
def sum_silhouette(covariance, rotation):
    return dpc_jax.project(
        jnp.zeros((1, 3)),
        rotation,
        covariance=covariance[None],
        grid=dpc_jax.VoxelGrid(5),
    ).silhouette.sum()


@pytest.mark.slow  # it compiles for half a minute; tests/test_stability.py has others
def test_a_flat_covariance_turned_a_little_has_a_gradient():
    # A line along x, turned so that its depth variance is 1e-19: the factors of an
    # order of axes that is not its own overflow.
    line = jnp.diag(jnp.array([1.0, 0, 0]))
    value, slopes = sum_silhouette(line, jnp.array([0, 0.5, 0, 4555501056.0]))
    level, expected = sum_silhouette(line, jnp.array([0.0, 0, 0, 1]))
    # Variance 0 along x, yet "correlated" with y and z.
    matrix = jnp.diag(jnp.array([1.0, 0, 0])) - 1
    others = sum_silhouette(matrix, jnp.array([0, -1, -5.7e19, 0]))
    np.testing.assert_allclose(value, level, rtol=1e-6)  # the tilt is 2e-10
    np.testing.assert_allclose(slopes[0], expected[0], rtol=1e-5, atol=1e-6)
    assert all(np.all(np.isfinite(a)) for a in jax.tree.leaves((slopes, others)))


def test_what_is_no_covariance_has_a_finite_slope_under_a_large_cotangent():
    # As a random draw made it: an indefinite matrix, seen from 394,738 away.
    matrix = np.zeros((1, 3, 3), "f4")
    matrix[0, 0] = [1.9e-18, 1.6e-12, -7.1e-7]
    matrix[0, :, 0] = matrix[0, 0]
    factors, pull_back = jax.vjp(factoring.factor_covariance, matrix)
    (slopes,) = pull_back(jax.tree.map(lambda a: jnp.full_like(a, 1e30), factors))
    assert np.all(np.isfinite(slopes))


@pytest.mark.parametrize("dtype", ["float64", "float16"])
def test_weights_of_many_points_have_the_derivative_of_each_alone(dtype):
    # From below the floor to kernels wider than any grid; centres on cells, in the
    # middle of two, outside the axis. Written out, as autodiff would do it.
    rng = np.random.default_rng(0)
    size, largest = 9, {"float16": 1e3, "float64": 1e30}[dtype]
    sigma = np.array([0, 0.02, 0.1, 0.3, 0.49, 0.51, 1, 3, 30, largest])
    centers = np.concatenate([[4.0, 4.5, -0.5, 8.49, -3], rng.uniform(-1, 9, 20)])
    weights = rng.normal(size=(len(centers), len(sigma), size))

    def sample_each(centers, sigma):
        cells = jnp.arange(size, dtype=centers.dtype)
        sampled = kernels.sample_gaussian(cells, sigma, center=centers)
        return kernels.cut_negligible(sampled, cells, sigma, center=centers)

    @functools.partial(jax.jit, static_argnums=0)
    def differentiate(sample, centers, sigma, cotangents):
        found, pull_back = jax.vjp(sample, centers, sigma)
        return found, *pull_back(cotangents)

    with jax.enable_x64(True):
        pairs = np.meshgrid(centers, sigma, indexing="ij")
        inputs = [jnp.asarray(a).astype(dtype) for a in map(np.ravel, pairs)]
        inputs.append(jnp.asarray(weights.reshape(-1, size)).astype(dtype))
        sample_all = functools.partial(kernels.sample_axis, size=size)
        found = differentiate(sample_all, *inputs)
        wide = [a.astype("float64") for a in inputs]
        expected = differentiate(jax.vmap(sample_each), *wide)
        found, expected = ([np.asarray(a, "f8") for a in b] for b in (found, expected))
    unit = float(jnp.finfo(dtype).eps)
    np.testing.assert_allclose(found[0], expected[0], rtol=0, atol=8 * unit)
    for slope, reference in zip(found[1:], expected[1:], strict=True):
        assert np.all(np.isfinite(slope))
        # Relative to the largest: sums of terms of either sign.
        error = np.abs(slope - reference).max()
        assert error <= 64 * unit * np.abs(reference).max()


def test_a_tile_beyond_the_circle_that_a_point_reaches_is_left_out():
    # It reaches 0.78 * 5.77 + 0.5 = 5 cells: the tiles below and beside its own are 4
    # away, the one across the corner 5.7. There the product of the weights that are
    # left would be exp(-26) of the peak, not zero.
    centre = np.full((1, 3), 4.0, "f4")
    volume = fill(centre, np.ones((1, 1), "f4"), 0.78, shape=(12, 12, 6))[0]
    assert np.any(volume[8:, :8]) and np.any(volume[:8, 8:])
    assert not np.any(volume[8:, 8:]) and not np.any(volume[10:])
