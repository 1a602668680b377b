"""Volumes and rays: points on borders, kernels of every width, empty and full cells."""

import functools

import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability import DTYPES, oracles
from dpc_jax.measure.stability.case import IN_WIDE, WIDE, make_cases
from dpc_jax.measure.stability.oracles import REAL
from dpc_jax.measure.stability.runner import tabulate
from dpc_jax.render import (
    compensate_widening,
    mass_of_peak,
    opacity,
    smooth,
    splat,
    termination_probabilities,
)
from dpc_jax.render.exact.covariances import sum_covariances

SHAPE = (4, 3, 5)
CROWD = 100_000
PLACE = [[0.3, 1.2, 2.7], [1.6, 0.4, 3.9], [2.1, 1.1, 0.2]]
VALUES = np.array([1.0, -0.5, 2.0])
ON_CENTRES = [[0, 1, 2], [3, 2, 4], [0, 0, 0]]
BETWEEN = [[0.5, 1, 2], [0.5, 1.5, 2], [1.5, 0.5, 2.5]]
AT_RIM = [[-0.5, 1, 2], [3.5, 2.5, 2], [-0.25, 2.25, 4.25]]
FAR = [[-1e30, 0, 0], [1e30, 1, 1], [-1, 3, 5]]
BESIDE = [[1e-7, 1, 2], [3, 2 - 1e-7, 4], [0, 0, 1e-7]]
SPLATS = (
    ("plain", PLACE, VALUES),
    ("on cell centres", ON_CENTRES, VALUES),
    ("on faces, edges and corners of cells", BETWEEN, VALUES),
    ("on the volume's border and within the outer half cell", AT_RIM, VALUES),
    ("all outside, up to 1e30", FAR, VALUES, IN_WIDE),
    # 16 bits round to the centre.
    ("1e-7 beside a cell centre", BESIDE, VALUES, IN_WIDE),
    ("plain, of mass 0", PLACE, np.zeros(3)),
    ("plain, of masses from 1e-30 to 1e30", PLACE, [1e-30, 1.0, 1e30], IN_WIDE),
    ("no point", np.zeros((0, 3)), np.zeros(0), {"is_slow": True}),
)
GRIDS = (
    (SHAPE, SPLATS),
    ((1, 1, 1), [("a grid of one cell", [[0.25, -0.25, 0], [0, 0, 0.5]], [1, 2])]),
    ((3, 5, 7), [("a grid of primes", [[0.25, 4.25, 6.4], [2, 0, 0.5]], [1, 2])]),
)
VOLUME = np.cos(3.0 * np.arange(60)).reshape(SHAPE) + 1.5
# Gradients in units of the slope for each voxel of σ, or of σ itself where it is wide.
BROAD = {"gradient_floor": 1e-6}
WIDTHS = (
    ("sigma 0", VOLUME, 0.0),
    ("sigma 1e-3", VOLUME, 1e-3),
    ("sigma -1", VOLUME, -1.0),
    ("sigma 0.17, where the neighbour counts", VOLUME, 0.17),
    ("sigma 0.5, where the formulas change", VOLUME, 0.5),
    ("sigma 1", VOLUME, 1.0),
    ("sigma 4", VOLUME, 4.0, BROAD),
    ("sigma 1e3", VOLUME, 1e3, BROAD),
    ("sigma 3e38", VOLUME, 3e38, BROAD),
    ("a grid of 1 x 1 x 1", VOLUME[:1, :1, :1], 0.8, {"is_slow": True}),
    ("a grid of 2 x 3 x 4", VOLUME[:2, :, :4], 0.8, {"is_slow": True}),
)
# The slope in the peak, 1.6e40, is beyond float32.
STEEP = {"gradient_tolerance": None}
PEAKS = (
    ("plain", 0.5, 1.5),
    ("sigma 1e-10", 1.0, 1e-10, IN_WIDE),
    ("peak 1e-20, sigma 1e13", 1e-20, 1e13, STEEP | IN_WIDE),
    ("peak 1e30, sigma 1e-15", 1e30, 1e-15, IN_WIDE),
    ("sigma 0", 1.0, 0.0),
)
AT_KINK = {"gradient_tolerance": None}
# Without a gradient at half a voxel, where the slope of the smaller sigma is taken, and
# at one, where it is half of each side's. In 16 bits 0.500001 is the kink itself.
COMPENSATED = (
    *((f"sigma {s:g}", s) for s in (0.0, 1e-30, 0.3, 0.75, 2.0, 3e38)),
    ("sigma 0.5", 0.5, AT_KINK),
    ("sigma 0.500001", 0.500001, IN_WIDE),
    ("sigma 1", 1.0, AT_KINK),
)


def _crowd_mass(coordinate, value):
    coordinates = jnp.broadcast_to(coordinate, (CROWD, 3))
    return jnp.sum(splat(coordinates, jnp.broadcast_to(value, (CROWD,)), SHAPE))


def _find_mass(peak, sigma):
    return peak * (2 * oracles.PI) ** REAL(1.5) * sigma * sigma * sigma


def _narrow(sigma):
    """The oracle of `compensate_widening`."""
    if np.real(sigma) <= 0.5:
        return sigma
    return sigma * np.sqrt(1 - oracles.clip(2 * sigma - 1) / (6 * sigma * sigma))


SPLATTING = [
    *(
        case
        for shape, rows in GRIDS
        for case in make_cases(
            "splat",
            functools.partial(splat, shape=shape),
            functools.partial(oracles.splat, shape=shape),
            (8, 16),
            rows,
            because="three weights of one rounding each, and their product",
        )
    ),
    *make_cases(
        "splat",
        _crowd_mass,
        lambda coordinate, value: CROWD * value + 0 * np.sum(coordinate),
        (CROWD / 4, CROWD / 4),
        [("1e5 coincident points, mass 1e30", [1.25, 1.5, 2.75], 1e30)],
        # The gradient to the place is zero: what a point leaves on one side it takes on
        # the other.
        gradient_floor=CROWD * 1e30,
        because="equal terms all round the same way while the sum is between two "
        "powers of two: the last half of them errs by n/8, all of them by n/6",
        dtypes=WIDE,  # sums in 16 bits stop growing at 2/epsilon
    ),
    *make_cases(
        *("smooth", smooth, oracles.smooth, (64, 256), WIDTHS),
        because="three passes of sums of five products, kernels of ten roundings; "
        "the slope in sigma cancels where the kernel is wide",
        is_half_checked=False,
    ),
    *make_cases(
        *("mass of a peak", mass_of_peak, _find_mass, (8, 16), PEAKS),
        because="five products",
    ),
    *make_cases(
        *("compensated widening", compensate_widening, _narrow, (8, 64), COMPENSATED),
        because="the root of a number between 1/2 and 1",
    ),
]


SOLID = (5, 4, 6)
CENTERS = np.array([[1.3, 2.2, 2.7], [3.6, 0.4, 3.9], [2.1, 1.1, 0.2], [4.2, 2.9, 5.4]])
MASSES = np.array([1.0, 0.5, 2.0, 0.25])


def _turn(variances):
    """A covariance with these variances along the axes of a fixed rotation."""
    axes = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    return axes @ np.diag(variances) @ axes.T


TURNED = [_turn(v) for v in ([1, 2, 0.5], [0.3, 1, 2], [2, 1, 1], [0.7, 0.8, 1])]
ALONG_AXES = [
    np.diag(v) for v in ([1e4, 1e-8, 1], [1, 1e4, 1e-8], [4, 1, 1e-4], [1] * 3)
]
FLAT = np.array([[1.0, 1, 0], [1, 1, 0], [0, 0, 1]])
NEEDLE = np.outer([1.0, 0.5, -0.25], [1, 0.5, -0.25])
INDEFINITE = [np.diag([1, 1, -1e-12]), np.diag([-1e-9, 1, 1]), FLAT, TURNED[0]]
# A variance is known to epsilon times the widest: here 1e4, and a kernel as thin as
# 0.02 voxels multiplies that by its slope, 400.
THIN = {"value_tolerance": 1e4, "gradient_tolerance": 4e6}
COVARIANCES = (
    ("plain", TURNED),
    ("condition 1e12 along the axes", ALONG_AXES),
    ("condition 1e12, turned", [_turn([1e4, 1, 1e-8])] * 4, THIN),
    ("singular: a plane", [FLAT] * 4),
    ("singular: a needle", [NEEDLE] * 4),
    ("singular: a point", [np.zeros((3, 3))] * 4),
    ("barely indefinite", INDEFINITE),
    ("entries 1e30", [np.eye(3) * 1e30, *TURNED[1:]]),
)


def _sum(coordinates, masses, covariance):
    """Densities of Gaussians; `project` reads the symmetric part of a covariance."""
    covariance = (covariance + jnp.swapaxes(covariance, 1, 2)) / 2
    return sum_covariances(coordinates, masses[:, None], covariance, shape=SOLID)[0]


GAUSSIANS = make_cases(
    "covariance",
    _sum,
    functools.partial(oracles.sum_covariances, shape=SOLID),
    (256, 1024),
    [(name, CENTERS, MASSES, *rest) for name, *rest in COVARIANCES],
    because="a conditional variance cancels by its condition, three kernels follow",
    # A point at the floor of sigma leaves 1e-106 on the neighbours of its cell.
    gradient_floor=1e-30,
    dtypes=WIDE,
)


LONG = 1024
MIDDLE = np.linspace(0.1, 0.8, 6)
# In 16 bits 1 - 1e-7 is 1, and in float16 1e-9 is 0: these are cases all the same.
RAYS = {
    "plain": MIDDLE,
    "empty": np.zeros(6),
    "full": np.ones(6),
    "one full cell, the last": np.eye(6)[-1],
    "one full among others": np.where(np.arange(6) == 2, 1, MIDDLE),
    "two full among others": np.where(np.arange(6) % 3 == 1, 1, MIDDLE),
    "all at 1 - 1e-7": np.full(6, 1 - 1e-7),
    "all at 1e-30": np.full(6, 1e-30),
    "from 1e-30 to 1": np.array([1e-30, 1e-9, 0.5, 1e-20, 1, 1e-5]),
    "one full cell alone": np.array([1.0]),
    f"{LONG} at 1e-9": np.full(LONG, 1e-9),
    f"{LONG} at 1e-3": np.full(LONG, 1e-3),
    f"{LONG} full": np.ones(LONG),
}


# Tolerances grow with the length of the ray.
TERMINATION = [
    case
    for title, function, oracle, floor in (
        ("probabilities", termination_probabilities, oracles.terminate, 0),
        # The gradient is at most one; where it is zero, the oracle's sum leaves 1e-19.
        ("opacity", opacity, oracles.find_opacity, 1e-4),
    )
    for name, ray in RAYS.items()
    for case in make_cases(
        *(title, function, oracle, (2 * len(ray) + 8, 8 * len(ray) + 16)),
        [(name, ray)],
        because="each cell rounds the product twice, at worst in one direction",
        dtypes=WIDE if len(ray) == LONG else DTYPES,
        gradient_floor=floor,
        is_slow=len(ray) == 1,
    )
]
ROWS = tabulate(splat=SPLATTING, gaussian=GAUSSIANS, ray=TERMINATION)
