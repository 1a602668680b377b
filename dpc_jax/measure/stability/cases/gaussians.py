"""The basic method: sizes far apart, covariances singular and worse."""

import functools

import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability.cases import oracles
from dpc_jax.measure.stability.cases.case import IN_WIDE, WIDE, Case, make_cases
from dpc_jax.render.exact import covariances, gaussians

SUBJECT = "gaussian"
SHAPE = (5, 4, 6)
CENTERS = np.array([[1.3, 2.2, 2.7], [3.6, 0.4, 3.9], [2.1, 1.1, 0.2], [4.2, 2.9, 5.4]])
MASSES = np.array([1.0, 0.5, 2.0, 0.25])
# A point at the floor of sigma leaves 1e-106 on the neighbours of its cell.
ON_CELL = {"gradient_floor": 1e-30}
SIZES = (
    ("plain", CENTERS, MASSES, [0.6, 0.8, 1.0, 1.2]),
    ("from 1e-3 to 1e3", CENTERS, MASSES, [1e-3, 0.1, 10, 1e3], IN_WIDE),
    ("all 0", CENTERS, MASSES, [0, 0, 0, 0], ON_CELL),
    ("from 1e-30 to 1e30", CENTERS, MASSES, [1e-30, 0.3, 1e15, 1e30], IN_WIDE),
    ("up to 3e38", CENTERS, MASSES, [0.5, 1.0, 2.0, 3e38], IN_WIDE),
)


def _turn(variances):
    """A covariance with these variances along the axes of a fixed rotation."""
    axes = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    return axes @ np.diag(variances) @ axes.T


PLAIN = [_turn(v) for v in ([1, 2, 0.5], [0.3, 1, 2], [2, 1, 1], [0.7, 0.8, 1])]
ALONG_AXES = [
    np.diag(v) for v in ([1e4, 1e-8, 1], [1, 1e4, 1e-8], [4, 1, 1e-4], [1] * 3)
]
FLAT = np.array([[1.0, 1, 0], [1, 1, 0], [0, 0, 1]])
NEEDLE = np.outer([1.0, 0.5, -0.25], [1, 0.5, -0.25])
INDEFINITE = [np.diag([1, 1, -1e-12]), np.diag([-1e-9, 1, 1]), FLAT, PLAIN[0]]
ZERO = "a variance below zero counts as zero: the nearest cell, with zero gradient"
BELOW = {"limit": ZERO}
THIN = {
    "value_tolerance": 1e4,
    "gradient_tolerance": 4e6,
    "limit": "a variance is known to epsilon times the widest: here 1e4, and a kernel "
    "as thin as 0.02 voxels multiplies that by its slope, 400",
}
COVARIANCES = (
    ("plain", PLAIN, {}),
    ("condition 1e12 along the axes", ALONG_AXES, {}),
    ("condition 1e12, turned", [_turn([1e4, 1, 1e-8])] * 4, THIN),
    ("singular: a plane", [FLAT] * 4, BELOW),
    ("singular: a needle", [NEEDLE] * 4, BELOW),
    ("singular: a point", [np.zeros((3, 3))] * 4, BELOW | ON_CELL),
    ("barely indefinite", INDEFINITE, BELOW),
    ("entries 1e30", [np.eye(3) * 1e30, *PLAIN[1:]], {}),
)


def _sum_isotropic(coordinates, masses, sigma):
    density = gaussians.sum_gaussians(coordinates, masses[:, None], sigma, shape=SHAPE)
    return jnp.squeeze(density, 0)


def _sum_anisotropic(coordinates, masses, covariance):
    """The same with covariances, of which `project` reads the symmetric part."""
    covariance = (covariance + jnp.swapaxes(covariance, 1, 2)) / 2
    density = covariances.sum_covariances(
        coordinates, masses[:, None], covariance, shape=SHAPE
    )
    return jnp.squeeze(density, 0)


def list_cases() -> list[Case]:
    """The catalogue's cases on the basic method."""
    own_sizes = functools.partial(oracles.sum_gaussians, shape=SHAPE)
    own_shapes = functools.partial(oracles.sum_covariances, shape=SHAPE)
    none = ("no point", np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    matrices = [(name, CENTERS, MASSES, m, fields) for name, m, fields in COVARIANCES]
    return [
        *make_cases(
            "sigma per point",
            *(_sum_isotropic, own_sizes, (64, 256), SIZES),
            because="three kernels of ten roundings, exponents up to 40 in size",
            half="finite",
        ),
        *make_cases(
            "sigma per point",
            *(_sum_isotropic, own_sizes, (0, 0), [none]),
            because="nothing is computed",
        ),
        *make_cases(
            "covariance",
            *(_sum_anisotropic, own_shapes, (256, 1024), matrices),
            because="a conditional variance cancels by its condition, three kernels "
            "follow",
            half="finite",
            dtypes=WIDE,
        ),
    ]
