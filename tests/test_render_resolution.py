"""Points on a finer grid: what each power of the ratio keeps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.measure.stability import oracles
from dpc_jax.render.projection import MASS_EXPONENT, scale_sizes

SIDE, RATIO = 10, 3
SIGMA, MASS = 1.2, 0.05  # voxels of the coarse grid; no cell comes near the clip
rng = np.random.default_rng(0)
POINTS, ROTATION = rng.uniform(-0.1, 0.1, (6, 3)), rng.normal(size=4)


def sum_written(side, sigma, mass):
    """Densities [side]³ in float64, by the written equations."""
    coordinates, _ = oracles.place(POINTS, ROTATION, shape=(side,) * 3)
    masses = np.full(len(POINTS), mass)
    return oracles.sum_gaussians(coordinates, masses, sigma, (side,) * 3)


@pytest.mark.parametrize("exponent", [2, 3])
def test_mass_by_r3_keeps_each_density_and_mass_by_r2_the_optical_depth(exponent):
    coarse = sum_written(SIDE, SIGMA, MASS)
    sizes = scale_sizes(SIGMA, MASS, RATIO, exponent=exponent)
    fine = sum_written(SIDE * RATIO, *sizes)
    # Of three fine cells per side the middle one has the centre of the coarse cell.
    same = fine[1::RATIO, 1::RATIO, 1::RATIO]
    # Aliasing of the sampled kernel at 1.2 voxels, 2·exp(-2π²·1.44) = 1e-12, relative.
    close = {"rtol": 1e-10, "atol": 1e-14}
    np.testing.assert_allclose(same, coarse * RATIO ** (exponent - 3), **close)
    depth = fine[1::RATIO, 1::RATIO].sum(-1)
    # The grid ends 4 standard deviations from the points: 6e-5 of their mass is cut.
    np.testing.assert_allclose(
        depth, coarse.sum(-1) * RATIO ** (exponent - 2), rtol=1e-3, atol=1e-9
    )


def test_the_package_fills_both_grids_with_those_densities():
    for ratio in (1, RATIO, 0.5):
        side = int(SIDE * ratio)
        sigma, mass = scale_sizes(SIGMA, MASS, ratio)
        with jax.enable_x64(True):
            occupancy = dpc_jax.voxelize(
                jnp.asarray(POINTS),
                ROTATION,
                sigma=sigma,
                scale=mass,
                grid=dpc_jax.VoxelGrid(side),
                method="gaussian",
            )
        expected = sum_written(side, sigma, mass)
        assert expected.max() < 1
        # The package cuts kernels where they fall below rounding.
        np.testing.assert_allclose(occupancy, expected, rtol=0, atol=1e-15)


def test_there_and_back_is_where_one_was():
    assert scale_sizes(*scale_sizes(1.5, 0.25, 2), 0.5) == (1.5, 0.25)
    assert scale_sizes(1.0, 1.0, 2) == (2.0, 2.0**MASS_EXPONENT)
