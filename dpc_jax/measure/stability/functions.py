"""Cases of single functions: rotations, splats, kernels, rays and losses.

Tolerances count the roundings of a function, in units of epsilon, or say why more.
"""

import functools

import jax.numpy as jnp
import numpy as np

from dpc_jax.learning import losses
from dpc_jax.measure.stability import oracles
from dpc_jax.measure.stability.oracles import REAL
from dpc_jax.measure.stability.runner import IN_WIDE, WIDE, make_cases
from dpc_jax.render import (
    mass_of_peak,
    opacity,
    quaternion,
    smooth,
    splat,
    termination_probabilities,
)
from dpc_jax.render.exact.covariances import sum_covariances

NO_GRADIENT = {"gradient_tolerance": None}

# Rotations.
SKEW, STILL = (0.5, -1.0, 2.0, 0.25), (1, 0, 0, 0)  # a quaternion; the identity
LENGTHS = (
    ("length 1e-30", np.multiply(SKEW, 1e-30)),
    ("length 1e30", np.multiply(SKEW, 1e30)),
    # 1 / 9e37 is subnormal, which processors flush to zero.
    ("length 1.3e38", (0, 0, 9e37, -9e37), IN_WIDE),
    ("components from 1e-30 to 1", (1e-30, 1, 1e-15, -1e-3)),
    ("near identity, 1e-7", (1, 1e-7, -1e-7, 2e-7)),
    ("zero", [0] * 4),
)
PAIRS = (
    ("plain", SKEW, (1, 2, 3, 4)),
    ("1e30 by 1e-30", np.multiply(SKEW, 1e30), (1e-30, 2e-30, 3e-30, 4e-30)),
)
POINTS = np.array([[0.3, -0.4, 0.5], [1e-7, 1, 1e3], [0, 0, 0]])
BRANCHES = (
    ("w largest", (1, 0.1, -0.2, 0.3)),
    ("x largest", (0.1, 1, -0.2, 0.3)),
    ("y largest", (0.1, -0.2, -1, 0.3)),
    ("z largest", (0.1, -0.2, 0.3, 1)),
    ("half turn about x", (0, 1, 0, 0)),
    ("half turn, two branches tie", (0, np.sqrt(0.5), np.sqrt(0.5), 0)),
    ("1e-7 from a half turn", (1e-7, 1, -2, 3)),
    ("all four tie", (1, -1, 1, 1)),
    ("identity", STILL),
)
# In 16 bits these round to equal rotations, or to subnormal numbers.
ANGLES = (
    ("plain", SKEW, (1, 2, 3, 4)),
    ("1e30 and 1e-30", np.multiply(SKEW, 1e30), (1e-30, 0, 1e-30, 0)),
    ("q and -q", (0.5, 0.5, -0.5, 0.5), (-0.5, -0.5, 0.5, -0.5)),
    ("equal", STILL, STILL),
    ("1e-25 apart", (1, 1e-25, 0, 0), STILL, IN_WIDE),
    ("1e-7 apart", (1, 1e-7, 0, 0), (1, 0, 1e-7, 0), IN_WIDE),
    ("half turn", STILL, (0, 0, 1, 0)),
    ("1e-7 from a half turn", STILL, (1e-7, 0, 1, 0)),
)
ABOUT = {"0": 0.0, "1e-30": 1e-30, "a half turn": np.pi, "1e4": 1e4}


def _pass_through_matrix(q):
    """As q·qᵀ, which is the same for q and -q."""
    back = quaternion.from_matrix(quaternion.to_matrix(q))
    return jnp.outer(back, back)


def _square(q):
    return np.outer(oracles.normalize(q), oracles.normalize(q))


def _turn_about(axis, angle):
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])


ROTATIONS = [
    *make_cases("normalize", quaternion.normalize, oracles.normalize, (4, 16), LENGTHS),
    *make_cases("multiply", quaternion.multiply, oracles.multiply, (8, 8), PAIRS),
    *make_cases(  # the gradient of q cancels along q
        *("rotate", quaternion.rotate, oracles.rotate, (16, 64)),
        [(name, POINTS, *rest) for name, *rest in LENGTHS],
    ),
    *make_cases("matrix and back", _pass_through_matrix, _square, (8, 32), BRANCHES),
    *make_cases("angle", quaternion.angle_between, oracles.angle, (16, 64), ANGLES),
    *make_cases(
        *("from axis and angle", quaternion.from_axis_angle, _turn_about, (4, 8)),
        [(name, (0.0, -0.6, 0.8), angle) for name, angle in ABOUT.items()],
        dtypes=WIDE,
    ),
]

# Volumes.
SHAPE = (4, 3, 5)
PLACE = [[0.3, 1.2, 2.7], [1.6, 0.4, 3.9], [2.1, 1.1, 0.2]]
VALUES = np.array([1.0, -0.5, 2.0])
SPLATS = (
    ("plain", PLACE, VALUES),
    ("on cell centres", [[0, 1, 2], [3, 2, 4], [0, 0, 0]], VALUES),
    (
        "on faces, edges and corners of cells",
        *([[0.5, 1, 2], [0.5, 1.5, 2], [1.5, 0.5, 2.5]], VALUES),
    ),
    (
        "on the volume's border and within the outer half cell",
        *([[-0.5, 1, 2], [3.5, 2.5, 2], [-0.25, 2.25, 4.25]], VALUES),
    ),
    (
        "all outside, up to 1e30",
        *([[-1e30, 0, 0], [1e30, 1, 1], [-1, 3, 5]], VALUES, IN_WIDE),
    ),
    (  # 16 bits round to the centre
        "1e-7 beside a cell centre",
        *([[1e-7, 1, 2], [3, 2 - 1e-7, 4], [0, 0, 1e-7]], VALUES, IN_WIDE),
    ),
    ("plain, of mass 0", PLACE, np.zeros(3)),
    ("plain, of masses from 1e-30 to 1e30", PLACE, [1e-30, 1.0, 1e30], IN_WIDE),
    ("no point", np.zeros((0, 3)), np.zeros(0), {"is_slow": True}),
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
    ("a grid of one cell", VOLUME[:1, :1, :1], 0.8, {"is_slow": True}),
)
PEAKS = (
    ("plain", 0.5, 1.5),
    ("sigma 1e-10", 1.0, 1e-10, IN_WIDE),
    # The slope in the peak, 1.6e40, is beyond float32.
    ("peak 1e-20, sigma 1e13", 1e-20, 1e13, NO_GRADIENT | IN_WIDE),
    ("peak 1e30, sigma 1e-15", 1e30, 1e-15, IN_WIDE),
    ("sigma 0", 1.0, 0.0),
)


def _find_mass(peak, sigma):
    return peak * (2 * oracles.PI) ** REAL(1.5) * sigma * sigma * sigma


SPLATTING = [
    *make_cases(
        "splat",
        functools.partial(splat, shape=SHAPE),
        functools.partial(oracles.splat, shape=SHAPE),
        *((8, 16), SPLATS),
    ),
    *make_cases(  # the slope in sigma cancels where the kernel is wide
        *("smooth", smooth, oracles.smooth, (64, 256), WIDTHS),
        is_half_checked=False,
    ),
    *make_cases("mass of a peak", mass_of_peak, _find_mass, (8, 16), PEAKS),
]

# Covariances.
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
    (256, 1024),  # a conditional variance cancels by its condition
    [(name, CENTERS, MASSES, *rest) for name, *rest in COVARIANCES],
    # A point at the floor of sigma leaves 1e-106 on the neighbours of its cell.
    gradient_floor=1e-30,
    dtypes=WIDE,
)

# Rays.
MIDDLE = np.linspace(0.1, 0.8, 6)
# In 16 bits 1 - 1e-7 is 1, and in float16 1e-9 is 0: these are cases all the same.
RAYS = (
    ("plain", MIDDLE),
    ("empty", np.zeros(6)),
    ("full", np.ones(6)),
    ("one full cell, the last", np.eye(6)[-1]),
    ("one full among others", np.where(np.arange(6) == 2, 1, MIDDLE)),
    ("two full among others", np.where(np.arange(6) % 3 == 1, 1, MIDDLE)),
    ("all at 1 - 1e-7", np.full(6, 1 - 1e-7)),
    ("all at 1e-30", np.full(6, 1e-30)),
    ("from 1e-30 to 1", [1e-30, 1e-9, 0.5, 1e-20, 1, 1e-5]),
)
LONG = 1024
LONG_RAYS = (
    (f"{LONG} at 1e-9", np.full(LONG, 1e-9), IN_WIDE),
    (f"{LONG} at 1e-3", np.full(LONG, 1e-3), IN_WIDE),
    (f"{LONG} full", np.ones(LONG), IN_WIDE),
)
TERMINATION = [
    case
    for title, function, oracle, floor in (
        ("probabilities", termination_probabilities, oracles.terminate, 0),
        # The gradient is at most one; where it is zero, the oracle's sum leaves 1e-19.
        ("opacity", opacity, oracles.find_opacity, 1e-4),
    )
    # Each cell rounds the product twice, at worst in one direction.
    for tolerances, rays in (
        ((20, 64), RAYS),
        ((2 * LONG + 8, 8 * LONG + 16), LONG_RAYS),
    )
    for case in make_cases(
        *(title, function, oracle, tolerances, rays), gradient_floor=floor
    )
]

# Losses.
GREY = np.linspace(0, 1, 9).reshape(3, 3)
IMAGES = (
    ("plain", GREY, GREY.T),
    ("equal", GREY, GREY),
    ("empty against full", 0 * GREY, 0 * GREY + 1),
    ("1e-7 apart", GREY, GREY - 1e-7, IN_WIDE),
    ("colours 1e6", GREY * 1e6, GREY.T * 1e6, IN_WIDE),
)
STUDENTS = (
    ("plain", SKEW, (1, 2, 3, 4)),
    ("equal", (0.5,) * 4, (0.5,) * 4),
    ("q and -q", (0.5,) * 4, (-0.5,) * 4),
    ("opposite, 180°", (1, 0, 0, 0), (0, 0, 1, 0)),
    ("opposite, 1e-7 beyond", (1, 0, -1e-7, 0), (0, 0, 1, 0), IN_WIDE),
    ("1e-30 and 1e30", np.multiply(SKEW, 1e-30), (1e30, 2e30, 0, 0), IN_WIDE),
    ("a student of 0", (0,) * 4, (1, 2, 3, 4)),
)
CLOUD = np.array([[0.1, -0.2, 0.3], [-0.3, 0.2, -0.1], [0.0, 0.4, 0.2]])
OF_ONE = {"gradient_floor": 1.0}
SAME = np.repeat(CLOUD[:1], 3, axis=0)
CLOUDS = (
    ("plain", CLOUD, OF_ONE),
    ("beyond the sphere", CLOUD * 1.5, OF_ONE),
    ("coincident points", SAME),
    ("1e-20 apart", SAME * 0 + np.arange(3)[:, None] * 1e-20, IN_WIDE),
    ("1e15 wide", CLOUD * 1e15, IN_WIDE),
    ("exactly on the sphere", [[0.5, 0, 0], [0, -0.5, 0], [0, 0, 0]], OF_ONE),
)


def _find_reprojection_loss(a, b):
    return np.sum((a - b) * (a - b))


def _find_student_loss(student, teacher):
    """1 - |cos| of unit quaternions; at cos = 0 the slope towards +teacher."""
    cosine = np.sum(oracles.normalize(student) * oracles.normalize(np.real(teacher)))
    return 1 - oracles.flip_sign(cosine)


def _find_repulsion(points):
    """Mean of 1/√(d² + 0.02²) over all pairs of points."""
    i, j = np.triu_indices(len(points), 1)
    squares = np.sum((points[i] - points[j]) ** 2, axis=1)
    return np.mean(1 / np.sqrt(squares + REAL(0.02) * REAL(0.02)))


def _find_containment(points):
    """Sum of squared distances outside the ball of radius a half."""
    lengths = np.sqrt(np.sum(points * points, axis=1))
    return np.sum(np.where(np.real(lengths) > 0.5, lengths - REAL(0.5), 0) ** 2)


LOSSES = [
    *make_cases(
        *("reprojection", losses.reprojection_loss, _find_reprojection_loss),
        *((16, 4), IMAGES),
    ),
    *make_cases(  # the gradient cancels along q
        *("student", losses.student_loss, _find_student_loss, (8, 16), STUDENTS),
        floor=1.0,
        gradient_floor=1.0,
    ),
    *make_cases(  # a softening of 1/50 magnifies what is near
        *("repulsion", losses.repulsion_energy, _find_repulsion, (64, 256), CLOUDS),
        is_half_checked=False,
    ),
    *make_cases(
        *("containment", losses.containment_loss, _find_containment, (64, 256), CLOUDS),
        is_half_checked=False,
    ),
]
CASES = {"rotation": ROTATIONS, "splat": SPLATTING, "gaussian": GAUSSIANS}
CASES |= {"ray": TERMINATION, "loss": LOSSES}
