"""What rays make of occupancies: their maximum, their clip; sizes on a finer grid."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.measure.stability import oracles
from dpc_jax.render.projection import MASS_EXPONENT, scale_sizes
from dpc_jax.render.volume import clip_unit

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


@pytest.mark.parametrize(
    ("density", "slope"), [(-0.1, 0.0), (0.0, 1.0), (0.3, 1.0), (1.0, 1.0), (1.1, 0.0)]
)
def test_the_clip_passes_gradients_at_both_of_its_ends(density, slope):
    assert jax.grad(clip_unit)(density) == slope
    assert clip_unit(jnp.float32(density)) == np.clip(np.float32(density), 0, 1)


@functools.partial(jax.jit, static_argnames="rule")
def draw(volume, rotation, *, rule):
    return dpc_jax.project_volume(
        volume,
        rotation,
        camera=dpc_jax.Camera(projection="orthographic"),
        grid=dpc_jax.VoxelGrid(8),
        ray_rule=rule,
    ).silhouette


def test_under_the_maximum_only_the_fullest_cells_of_a_ray_have_a_gradient():
    """Samples lie on the centres of cells, exactly: sides are powers of two."""

    def look(ray):
        volume = jnp.zeros((8, 8, 8)).at[4, 4].set(ray)
        return draw(volume, jnp.eye(3), rule="maximum")[4, 4]

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


@pytest.mark.parametrize("exponent", [2, MASS_EXPONENT])
def test_mass_by_r3_keeps_each_density_and_mass_by_r2_the_optical_depth(exponent):
    side, ratio, points = 10, 3, POINTS.astype("f8") / 3
    sizes = scale_sizes(1.2, 0.05, ratio, exponent=exponent)
    volumes = []
    for cells, (sigma, mass) in ((side, (1.2, 0.05)), (side * ratio, sizes)):
        shape = (cells,) * 3
        places, _ = oracles.place(points, POSE, shape=shape)
        masses = np.full(len(points), mass)
        volumes.append(oracles.sum_gaussians(places, masses, sigma, shape))
    coarse, fine = volumes
    # Of three fine cells per side the middle one has the centre of the coarse cell.
    same = fine[1::ratio, 1::ratio, 1::ratio]
    # Aliasing of the sampled kernel at 1.2 voxels, 2·exp(-2π²·1.44) = 1e-12, relative.
    close = {"rtol": 1e-10, "atol": 1e-14}
    np.testing.assert_allclose(same, coarse * ratio ** (exponent - 3), **close)
    depth = fine[1::ratio, 1::ratio].sum(-1)
    # The grid ends 4 standard deviations from the points: 6e-5 of their mass is cut.
    expected = coarse.sum(-1) * ratio ** (exponent - 2)
    np.testing.assert_allclose(depth, expected, rtol=1e-3, atol=1e-9)
    assert scale_sizes(*sizes, 1 / ratio, exponent=exponent) == pytest.approx(
        (1.2, 0.05)
    )
