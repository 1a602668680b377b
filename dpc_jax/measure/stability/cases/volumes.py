"""The fast method: points on borders, coincident, outside; kernels of every width."""

import functools

import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability.cases import oracles
from dpc_jax.measure.stability.cases.case import DTYPES, REAL, WIDE, Case
from dpc_jax.render import compensate_widening, mass_of_peak, smooth, splat

SUBJECT = "splat and smooth"
SHAPE = (4, 3, 5)
KINK = "linear between cell centres: at one, the slope towards the higher index"
OUTSIDE = "a point outside leaves no trace; of one inside, the share on cells outside "
OUTSIDE += "is lost"
FLOOR = "below 0.02 voxels a point stays on its cell, with zero gradient"
NEGATIVE = "below zero counts as zero; a plain number below zero is refused"
CROWD = 100_000


def splat_into(coordinates, values, *, shape):
    """`splat` with the shape bound by keyword."""
    return splat(coordinates, values, shape)


@functools.cache
def make_splat(shape):
    """One function per shape, so that cases share their programs."""
    return functools.partial(splat_into, shape=shape)


def crowd_mass(coordinate, value):
    """Mass of a crowd of coincident points, all in the volume."""
    coordinates = jnp.broadcast_to(coordinate, (CROWD, 3))
    return jnp.sum(splat(coordinates, jnp.broadcast_to(value, (CROWD,)), SHAPE))


def mass_of_smoothed(volume, sigma):
    """Mass that stays in the middle of a volume twelve deviations wide."""
    return jnp.sum(smooth(volume, sigma))


def list_cases() -> list[Case]:
    """The catalogue's cases on splatting, smoothing and masses."""
    return [
        *_list_splats(),
        *_list_crowds(),
        *_list_smooths(),
        *_list_masses(),
        *_list_widths(),
    ]


def _list_splats():
    values = np.array([1.0, -0.5, 2.0])
    places = {
        "plain": [[0.3, 1.2, 2.7], [1.6, 0.4, 3.9], [2.1, 1.1, 0.2]],
        "on cell centres": [[0, 1, 2], [3, 2, 4], [0, 0, 0]],
        "on faces, edges and corners of cells": [
            [0.5, 1, 2],
            [0.5, 1.5, 2],
            [1.5, 0.5, 2.5],
        ],
        "on the volume's border, low": [[-0.5, 1, 2], [-0.5, -0.5, 2], [-0.5] * 3],
        "on the volume's border, high": [[3.5, 1, 2], [3.5, 2.5, 2], [3.5, 2.5, 4.5]],
        "within the outer half cell": [[-0.25, 1, 2], [3.25, 1, 2], [1, 2.25, 4.25]],
        "one cell outside": [[-1, 1, 2], [4, 1, 2], [1, 3, 5]],
        "all outside, up to 1e30": [[-1e30, 0, 0], [1e30, 1, 1], [0, -20, 0]],
        "1e-7 beside a cell centre": [[1e-7, 1, 2], [3, 2 - 1e-7, 4], [0, 0, 1e-7]],
    }
    masses = {
        "of mass 0": np.zeros(3),
        "of mass 1e-12": values * 1e-12,
        "of mass 1e6": values * 1e6,
        "of masses from 1e-30 to 1e30": np.array([1e-30, 1.0, 1e30]),
    }
    scenes = {name: (place, values, SHAPE) for name, place in places.items()}
    scenes |= {
        f"plain, {name}": (places["plain"], mass, SHAPE)
        for name, mass in masses.items()
    }
    scenes |= {
        "no point": (np.zeros((0, 3)), np.zeros(0), SHAPE),
        "one point": ([[0.3, 1.2, 2.7]], [1.0], SHAPE),
        "a grid of one cell": ([[0.25, -0.25, 0], [0, 0, 0.5]], [1, 2], (1, 1, 1)),
        "a grid of one row": ([[0.25, 1.25, 3], [0, 0, 5.5]], [1, 2], (1, 2, 6)),
        "a grid 1 x 1 x 5": ([[0.25, -0.25, 3], [0, 0, 0.5]], [1, 2], (1, 1, 5)),
        "a grid of primes": ([[0.25, 4.25, 6.4], [2, 0, 0.5]], [1, 2], (3, 5, 7)),
    }
    for name, (coordinates, mass, shape) in scenes.items():
        yield Case(
            name=f"splat: {name}",
            subject=SUBJECT,
            function=make_splat(shape),
            inputs=(coordinates, mass),
            oracle=functools.partial(oracles.splat, shape=shape),
            value_tolerance=8,
            gradient_tolerance=16,
            because="three weights of one rounding each, and their product",
            # Between cells in 16 bits, a coordinate is what it is rounded to.
            limit=KINK
            if "centres" in name
            else OUTSIDE
            if "outside" in name or "outer" in name or "border" in name
            else "",
            dtypes=WIDE if "1e30" in name or "1e-7" in name else DTYPES,
        )


def _list_crowds():
    def count_all(coordinate, value):
        return np.asarray(CROWD * value + 0 * np.sum(coordinate))

    for name, value in {"": 1.0, ", mass 1e-12": 1e-12, ", mass 1e30": 1e30}.items():
        yield Case(
            name=f"splat: 1e5 coincident points{name}",
            subject=SUBJECT,
            function=crowd_mass,
            inputs=([1.25, 1.5, 2.75], value),
            oracle=count_all,
            value_tolerance=CROWD / 4,
            gradient_tolerance=CROWD / 4,
            # Zero: what a point leaves on one side it takes on the other.
            gradient_floor=CROWD * value,
            because="equal terms round alike between two powers of two: the last "
            "half of them errs by n/8, all by n/6",
            limit="sums in 16 bits stop growing at 2/epsilon: use float32",
            dtypes=WIDE,
        )


def _list_smooths():
    plain = np.array([np.cos(3.0 * np.arange(60)).reshape(SHAPE) + 1.5])[0]
    widths = {
        "sigma 0": (0.0, FLOOR),
        "sigma 1e-30": (1e-30, FLOOR),
        "sigma 1e-3": (1e-3, FLOOR),
        "sigma -1": (-1.0, NEGATIVE),
        "sigma 0.17, where the neighbour counts": (0.17, ""),
        "sigma 0.3": (0.3, ""),
        "sigma 0.5, where the formulas change": (0.5, ""),
        "sigma 1": (1.0, ""),
        "sigma 4": (4.0, ""),
        "sigma 1e3": (1e3, ""),
        "sigma 1e12": (1e12, ""),
        "sigma 1e30": (1e30, ""),
        "sigma 3e38": (3e38, ""),
    }
    for name, (sigma, limit) in widths.items():
        yield Case(
            name=f"smooth: {name}",
            subject=SUBJECT,
            function=smooth,
            inputs=(plain, sigma),
            oracle=oracles.smooth,
            value_tolerance=64,
            # In units of the slope for each voxel of σ, or of σ where it is wide.
            gradient_tolerance=256,
            because="three passes of sums of five products, kernels of ten roundings; "
            "the slope in sigma cancels where the kernel is wide",
            half="finite",
            limit=limit,
            gradient_floor=1e-6 if sigma > 1 else 0.0,
        )
    for shape in ((1, 1, 1), (1, 1, 5), (1, 6, 1), (2, 3, 7)):
        yield Case(
            name="smooth: a grid of " + " x ".join(map(str, shape)),
            subject=SUBJECT,
            function=smooth,
            inputs=(plain.ravel()[: np.prod(shape)].reshape(shape), 0.8),
            oracle=oracles.smooth,
            value_tolerance=64,
            gradient_tolerance=256,
            because="as above",
            half="finite",
            dtypes=WIDE,
        )
    lone = np.zeros((19, 19, 19))
    lone[9, 9, 9] = 1.0
    for sigma in (0.05, 0.2, 0.75):
        yield Case(
            name=f"smooth: mass in the middle, sigma {sigma}",
            subject=SUBJECT,
            function=mass_of_smoothed,
            inputs=(lone, sigma),
            oracle=lambda volume, sigma: np.sum(volume),
            value_tolerance=32,
            gradient_tolerance=None,
            because="nine cells away is twelve deviations, 1e-31 of the mass",
            dtypes=WIDE,
        )


def _list_masses():
    pairs = {
        "plain": (0.5, 1.5),
        "sigma 1e-10": (1.0, 1e-10),
        "peak 1e-20, sigma 1e12": (1e-20, 1e12),
        "peak 1e-20, sigma 1e13": (1e-20, 1e13),
        "peak 1e30, sigma 1e-15": (1e30, 1e-15),
        "sigma 0": (1.0, 0.0),
    }
    for name, (peak, sigma) in pairs.items():
        is_steep = sigma == 1e13
        yield Case(
            name=f"mass of a peak: {name}",
            subject=SUBJECT,
            function=mass_of_peak,
            inputs=(peak, sigma),
            oracle=lambda peak, sigma: np.asarray(
                peak * (2 * oracles.PI) ** REAL(1.5) * sigma * sigma * sigma
            ),
            value_tolerance=8,
            gradient_tolerance=None if is_steep else 16,
            because="five products",
            limit="the slope in the peak, 1.6e40, is beyond float32"
            if is_steep
            else "",
            dtypes=WIDE if "1e" in name else DTYPES,
        )


def _list_widths():
    def narrow(sigma):
        share = 2 * sigma - 1
        share = np.where(np.real(share) < 0, 0, np.where(np.real(share) > 1, 1, share))
        if np.real(sigma) <= 0.5:
            return np.asarray(sigma)
        return np.asarray(sigma * np.sqrt(1 - share / (6 * sigma * sigma)))

    for sigma in (0.0, 1e-30, 0.3, 0.5, 0.500001, 0.75, 1.0, 2.0, 1e3, 1e12, 3e38):
        # At half a voxel and at one the slope jumps; the side of smaller sigma is
        # taken at the first, and at the second half of both.
        at_kink = sigma in (0.5, 1.0)
        yield Case(
            name=f"compensated widening: sigma {sigma:g}",
            subject=SUBJECT,
            function=compensate_widening,
            inputs=(sigma,),
            oracle=narrow,
            value_tolerance=8,
            gradient_tolerance=None if at_kink else 64,
            because="a root of what is at least 1/2 of one",
            limit="its slope jumps at 0.5 and 1 voxels" if at_kink else "",
            # In 16 bits 0.500001 is the kink itself.
            dtypes=WIDE if sigma == 0.500001 else DTYPES,
        )
