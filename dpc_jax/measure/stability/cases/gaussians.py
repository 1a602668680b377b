"""The basic method: sizes far apart, covariances singular and worse."""

import functools

import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability.cases import oracles
from dpc_jax.measure.stability.cases.case import WIDE, Case
from dpc_jax.render.exact import covariances, gaussians

SUBJECT = "gaussian"
SHAPE = (5, 4, 6)
CENTERS = np.array([[1.3, 2.2, 2.7], [3.6, 0.4, 3.9], [2.1, 1.1, 0.2], [4.2, 2.9, 5.4]])
MASSES = np.array([1.0, 0.5, 2.0, 0.25])
THIN = "a variance is known to epsilon times the widest: here 1e4, and a kernel as "
THIN += "thin as 0.02 voxels multiplies that by its slope, 400"
BELOW = "a variance below zero counts as zero: the nearest cell, with zero gradient"


def sum_isotropic(coordinates, masses, sigma):
    """One Gaussian per point, with one mass each."""
    return gaussians.sum_gaussians(coordinates, masses[:, None], sigma, shape=SHAPE)[0]


def sum_anisotropic(coordinates, masses, covariance):
    """The same with covariances."""
    # As `project` does, which reads the symmetric part.
    covariance = (covariance + jnp.swapaxes(covariance, 1, 2)) / 2
    return covariances.sum_covariances(
        coordinates, masses[:, None], covariance, shape=SHAPE
    )[0]


def list_cases() -> list[Case]:
    """The catalogue's cases on the basic method."""
    return [*_list_sizes(), *_list_covariances()]


def _list_sizes():
    sizes = {
        "plain": [0.6, 0.8, 1.0, 1.2],
        "from 1e-3 to 1e3": [1e-3, 0.1, 10, 1e3],
        "all 0": [0, 0, 0, 0],
        "from 1e-30 to 1e30": [1e-30, 0.3, 1e15, 1e30],
        "up to 3e38": [0.5, 1.0, 2.0, 3e38],
    }
    for name, sigma in sizes.items():
        yield Case(
            name=f"sigma per point: {name}",
            subject=SUBJECT,
            function=sum_isotropic,
            inputs=(CENTERS, MASSES, sigma),
            oracle=functools.partial(oracles.sum_gaussians, shape=SHAPE),
            value_tolerance=64,
            gradient_tolerance=256,
            because="three kernels of ten roundings, exponents up to 40 in size",
            # What is left of the neighbours at the floor of sigma: 1e-106.
            gradient_floor=1e-30 if name == "all 0" else 0.0,
            half="finite",
            dtypes=WIDE if "e" in name else Case.dtypes,
        )
    yield Case(
        name="sigma per point: no point",
        subject=SUBJECT,
        function=sum_isotropic,
        inputs=(np.zeros((0, 3)), np.zeros(0), np.zeros(0)),
        oracle=lambda coordinates, masses, sigma: np.zeros(SHAPE),
        value_tolerance=0,
        gradient_tolerance=0,
        because="nothing is computed",
    )


def turn(variances):
    """A covariance with these variances along the axes of a fixed rotation."""
    axes = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    return axes @ np.diag(variances) @ axes.T


def _list_covariances():
    plain = [turn(v) for v in ([1, 2, 0.5], [0.3, 1, 2], [2, 1, 1], [0.7, 0.8, 1])]
    diagonal = [
        np.diag(v) for v in ([1e4, 1e-8, 1], [1, 1e4, 1e-8], [4, 1, 1e-4], [1] * 3)
    ]
    flat = np.array([[1.0, 1, 0], [1, 1, 0], [0, 0, 1]])
    needle = np.outer([1.0, 0.5, -0.25], [1, 0.5, -0.25])
    scenes = {
        "plain": (plain, 256, 1024, ""),
        "condition 1e12 along the axes": (diagonal, 256, 1024, ""),
        "condition 1e12, turned": ([turn([1e4, 1, 1e-8])] * 4, 1e4, 4e6, THIN),
        "singular: a plane": ([flat] * 4, 256, 1024, BELOW),
        "singular: a needle": ([needle] * 4, 256, 1024, BELOW),
        "singular: a point": ([np.zeros((3, 3))] * 4, 256, 1024, BELOW),
        "barely indefinite": (
            [np.diag([1, 1, -1e-12]), np.diag([-1e-9, 1, 1]), flat, plain[0]],
            256,
            1024,
            BELOW,
        ),
        "entries 1e30": ([np.eye(3) * 1e30, *plain[1:]], 256, 1024, ""),
    }
    for name, (matrices, value, gradient, limit) in scenes.items():
        yield Case(
            name=f"covariance: {name}",
            subject=SUBJECT,
            function=sum_anisotropic,
            inputs=(CENTERS, MASSES, np.array(matrices)),
            oracle=functools.partial(oracles.sum_covariances, shape=SHAPE),
            value_tolerance=value,
            gradient_tolerance=gradient,
            # What is left of the neighbours at the floor of sigma: 1e-106.
            gradient_floor=1e-30 if name == "singular: a point" else 0.0,
            because="a conditional variance cancels by its condition, three kernels "
            "follow",
            half="finite",
            limit=limit,
            dtypes=WIDE,
        )
