"""The basic method: every point its own Gaussian, isotropic or with a covariance."""

import functools

import densities
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.render import kernels
from dpc_jax.render.exact import covariances, factoring, gaussians, tiles

SHAPE = (11, 20, 9)  # neither cubic nor a multiple of a tile's side


def make_points(count=30, seed=0):
    rng = np.random.default_rng(seed)
    centre = np.array(SHAPE) / 2
    coordinates = centre + rng.uniform(-0.6, 0.6, (count, 3)) * np.array(SHAPE)
    return rng, coordinates, rng.normal(size=(count, 2))


@functools.partial(jax.jit, static_argnames="shape")
def fill(coordinates, values, sigma, shape=SHAPE):
    return gaussians.sum_gaussians(coordinates, values, sigma, shape=shape)


@functools.partial(jax.jit, static_argnames="shape")
def fill_covariances(coordinates, values, covariance, shape=SHAPE):
    return covariances.sum_covariances(coordinates, values, covariance, shape=shape)


@pytest.mark.parametrize("sigma", [0.0, 0.02, 0.3, 1.0, 4.0])
def test_the_mass_of_a_point_well_inside_is_exact(sigma):
    shape = (64, 64, 64)
    coordinates = np.full((1, 3), [31.5, 30.2, 33.0], "f4")
    volume = fill(coordinates, np.ones((1, 1), "f4"), np.float32(sigma), shape=shape)
    # Three normalisers, each right to a few roundings of 6e-8.
    assert float(volume.sum()) == pytest.approx(1, abs=2e-6)


def test_a_point_of_size_zero_falls_on_the_nearest_cell_and_a_tie_is_shared():
    coordinates = np.array([[3.4, 5.0, 6.0], [3.0, 7.5, 2.0]], "f4")
    volume = np.asarray(fill(coordinates, np.ones((2, 1), "f4"), np.zeros(2, "f4")))[0]
    assert volume[3, 5, 6] == 1
    assert volume[3, 7, 2] == 0.5 and volume[3, 8, 2] == 0.5
    assert np.count_nonzero(volume) == 3


def test_a_well_sampled_covariance_gives_the_continuous_density():
    rng, coordinates, values = make_points()
    half = rng.normal(size=(30, 3, 3)) * rng.uniform(0.3, 2, (30, 1, 1))
    matrices = half @ half.transpose(0, 2, 1) + 0.7 * np.eye(3)
    with jax.enable_x64(True):
        volume = fill_covariances(coordinates, values, matrices)
    expected = densities.sum_densities(coordinates, values, matrices, SHAPE)
    # Aliasing of the thinnest, 2·exp(-2π²·0.7) = 2e-6 of a density of at most 0.05.
    np.testing.assert_allclose(volume, expected, atol=3e-7)


@pytest.mark.parametrize("rank", [0, 1, 2])
def test_a_singular_covariance_keeps_mass_mean_and_extent(rank):
    rng = np.random.default_rng(rank)
    half = rng.normal(size=(3, 3)) * np.array([1.0] * rank + [0.0] * (3 - rank)) * 2.0
    matrix = half @ half.T
    centre = np.array([20.3, 19.8, 20.1])
    with jax.enable_x64(True):
        volume = fill_covariances(
            centre[None], np.ones((1, 1)), matrix[None], shape=(41, 41, 41)
        )[0]
    mass, mean, found = densities.moments(np.asarray(volume))
    # 41 cells hold 5 standard deviations; the nearest cell is at most 1/2 away, and
    # its rounding adds at most 1/4 to a variance.
    assert mass == pytest.approx(1, abs=1e-3)
    assert np.abs(mean - centre).max() <= 0.5
    assert np.abs(found - matrix).max() <= 0.25 + 0.02 * np.abs(matrix).max()


@jax.jit
@functools.partial(jax.value_and_grad, argnums=(0, 1))
def sum_silhouette(covariance, rotation):
    return dpc_jax.project(
        jnp.zeros((1, 3)),
        rotation,
        covariance=covariance[None],
        grid=dpc_jax.VoxelGrid(5),
    ).silhouette.sum()


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


def test_what_a_point_does_not_reach_is_exactly_zero():
    volume = np.asarray(fill(np.full((1, 3), 4.0, "f4"), np.ones((1, 1), "f4"), 0.5))[0]
    reached = np.argwhere(volume)
    assert reached.min() >= 4 - 3 and reached.max() <= 4 + 3  # 5.8 sigma
    assert volume[4, 4, 4] > 0


@pytest.mark.parametrize("dtype", ["float64", "float32", "float16"])
def test_weights_of_many_points_have_the_derivative_of_each_alone(dtype):
    # From below the floor to kernels wider than any grid; centres on cells, in the
    # middle of two, outside the axis. Written out, as autodiff would do it.
    rng = np.random.default_rng(0)
    size, largest = 9, {"float16": 1e3, "float32": 1e30, "float64": 1e30}[dtype]
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
        renders_at_once = functools.partial(kernels.sample_axis, size=size)
        found = differentiate(renders_at_once, *inputs)
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
    assert not np.any(volume[8:, 8:])


@pytest.mark.parametrize("count", [1, 63, 64, 65, 1000])
def test_a_tile_lists_the_points_that_reach_it_in_their_order(count):
    rng = np.random.default_rng(count)
    for share in (0, 0.1, 1):
        reaches = rng.uniform(size=count) < share
        order, number = tiles.find_points(jnp.asarray(reaches))
        expected = np.flatnonzero(reaches)
        assert number == len(expected)
        np.testing.assert_array_equal(order[:number], expected)
        np.testing.assert_array_equal(order[number:], count)  # the point of zeros


@functools.partial(jax.jit, static_argnames=("grid", "method"))
def render(points, rotation, sigma, grid, method):
    grid = dpc_jax.VoxelGrid(grid)
    mass = 0.004 * grid.shape[0] ** 3 / points.shape[0] * 40
    return dpc_jax.project(
        points,
        rotation,
        sigma=sigma * grid.shape[0],
        scale=mass * 0.05,
        grid=grid,
        method=method,
    ).silhouette


def test_trilinear_converges_to_gaussian_as_the_grid_grows():
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.25, 0.25, (40, 3)).astype("f4")
    rotation = rng.normal(size=4).astype("f4")
    errors = []
    for grid in (8, 16, 32):
        images = [
            np.asarray(render(points, rotation, 0.06, grid, method))
            for method in ("trilinear", "gaussian")
        ]
        errors.append(np.linalg.norm(images[0] - images[1]) / np.linalg.norm(images[1]))
    # Widening by 1/6 voxel² against (0.06·D)²: a quarter of it per doubling, once the
    # kernel is wide enough to be sampled.
    assert errors[1] < errors[0] and errors[2] < 0.35 * errors[1]


def test_covariances_turn_with_the_object():
    rng = np.random.default_rng(3)
    half = rng.normal(size=(6, 3, 3))
    matrices = half @ half.transpose(0, 2, 1) + np.eye(3)
    points = rng.uniform(-0.2, 0.2, (6, 3))
    quaternion = rng.normal(size=4)
    with jax.enable_x64(True):
        turn = np.asarray(dpc_jax.quaternion.to_matrix(jnp.asarray(quaternion)))
        shared = {
            "scale": 3.0,
            "grid": dpc_jax.VoxelGrid(12),
            "camera": dpc_jax.Camera(1.8, 2.0),
        }
        render = jax.jit(functools.partial(dpc_jax.project, **shared))
        moved = render(jnp.asarray(points), quaternion, covariance=matrices)
        turned = render(
            jnp.asarray(points @ turn.T), np.eye(3), covariance=turn @ matrices @ turn.T
        )
    np.testing.assert_allclose(moved.silhouette, turned.silhouette, atol=1e-12)


def test_perspective_zooms_a_covariance_by_its_derivative():
    # On the axis the derivative is focal/z across and one along the ray.
    with jax.enable_x64(True):
        camera = dpc_jax.Camera(1.5, 2.0)
        matrix = np.diag([4.0, 9.0, 16.0])[None]
        moved = covariances.move_covariance(
            jnp.asarray(matrix),
            jnp.asarray([[0.0, 0.0, 2.0]]),
            jnp.eye(3),
            camera=camera,
            grid=dpc_jax.VoxelGrid(16),
        )
    # x is across (the column), y is down (the row).
    np.testing.assert_allclose(
        moved[0], np.diag([9 * 0.75**2, 4 * 0.75**2, 16.0]), rtol=1e-14
    )
