"""Rays: their maximum, numbers that are not finite, sizes on a finer grid."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax

STILL = jnp.array([1.0, 0, 0, 0])
RNG = np.random.default_rng(0)
POINTS, POSE = RNG.uniform(-0.3, 0.3, (9, 3)).astype("f4"), RNG.normal(size=4)


@pytest.mark.parametrize("method", ["trilinear", "gaussian"])
def test_the_maximum_along_a_ray_is_that_of_its_occupancies(method):
    scene = {"sigma": 1.1, "scale": 1.5, "method": method}
    scene |= {"grid": dpc_jax.VoxelGrid((10, 12, 9))}
    image = jax.jit(lambda p: dpc_jax.project(p, POSE, **scene, ray_rule="maximum"))
    occupancy = jax.jit(lambda p: dpc_jax.voxelize(p, POSE, **scene))(POINTS)
    assert occupancy.shape == (10, 12, 9)
    # The two programs round apart, by an ulp or two.
    np.testing.assert_allclose(
        image(POINTS).silhouette, np.max(occupancy, axis=-1), rtol=1e-6
    )


def test_under_the_maximum_only_the_fullest_cells_of_a_ray_have_a_gradient():
    """Samples lie on the centres of cells, exactly: sides are powers of two."""

    def look(ray):
        return dpc_jax.project_volume(
            jnp.zeros((8, 8, 8)).at[4, 4].set(ray),
            jnp.eye(3),
            camera=dpc_jax.Camera(projection="orthographic"),
            grid=dpc_jax.VoxelGrid(8),
            ray_rule="maximum",
        ).silhouette[4, 4]

    measure = jax.jit(jax.value_and_grad(look))
    # Shared where none is fuller.
    for first, slopes in ((0.8, [1.0, 0.0]), (0.6, [0.5, 0.5])):
        ray = jnp.zeros(8).at[2].set(first).at[7].set(0.6)
        value, gradient = measure(ray)
        assert float(value) == pytest.approx(first, rel=1e-6)
        expected = np.zeros(8)
        expected[[2, 7]] = slopes
        np.testing.assert_allclose(gradient, expected, atol=1e-6)


@pytest.mark.parametrize("combine", [jax.vmap, lambda f: lambda x: jax.lax.map(f, x)])
def test_under_the_maximum_views_have_their_gradients_however_they_are_combined(
    combine,
):
    """XLA computes a ray's cells twice; that rounding differs may lose no gradient."""
    rng = np.random.default_rng(0)
    volume = jnp.asarray(rng.uniform(size=(8, 8, 8)), jnp.float32)
    rotations = jnp.asarray(rng.normal(size=(4, 4)), jnp.float32)

    def look(volume, rotation):
        grid = dpc_jax.VoxelGrid(8)
        image = dpc_jax.project_volume(volume, rotation, grid=grid, ray_rule="maximum")
        return jnp.sum(image.silhouette**2)

    one = jax.jit(jax.grad(look))
    wanted = sum(one(volume, rotation) for rotation in rotations)
    found = jax.jit(
        jax.grad(lambda v: jnp.sum(combine(lambda r: look(v, r))(rotations)))
    )(volume)
    np.testing.assert_allclose(found, wanted, atol=2e-5)  # float32 sums of 64 pixels


def test_places_that_are_not_finite_count_as_outside():
    nowhere = jnp.array([jnp.nan, 0, 0])
    image = jax.jit(dpc_jax.project_volume)(
        jnp.ones((4, 4, 4)), STILL, translation=nowhere
    )
    assert np.all(image.silhouette == 0)


def test_a_cell_that_is_not_finite_spoils_the_rays_that_read_it_alone():
    spoiled = np.full((4, 4, 4), 0.3, np.float32)
    spoiled[0, 0, 0] = np.nan
    grid = dpc_jax.VoxelGrid(4)
    image = np.asarray(dpc_jax.project_volume(spoiled, STILL, grid=grid).silhouette)
    # Half of the columns and half of the rows lie nearer to other cells.
    assert np.isnan(image[0, 0]) and np.isfinite(image[2:]).all()
    assert np.isfinite(image[:, 2:]).all()
