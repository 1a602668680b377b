"""Calls of the public functions with numbers that make no image."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hostile import Table, assert_try_says

import dpc_jax

TABLE = Table()
tries = TABLE.tries

CLOUD = np.random.default_rng(0).uniform(-0.3, 0.3, (5, 3)).astype("f4")
IDENTITY, MATRIX = np.array([1, 0, 0, 0], "f4"), np.eye(3, dtype="f4")
MATRICES, SINGULAR = np.tile(MATRIX, (5, 1, 1)), np.ones((5, 3, 3), "f4")
GRID = dpc_jax.VoxelGrid(4)


def project(points=CLOUD, rotation=IDENTITY, *, function=dpc_jax.project, **changes):
    arguments = {"sigma": 1.0, "grid": GRID} | changes
    image = function(points, rotation, **arguments).silhouette
    return "drawn" if np.isfinite(image).all() else "not finite"


SIGMA, SCALE = "sigma must be at least 0 voxels and", "scale must be at least 0 voxels"


@pytest.mark.parametrize("convert", [lambda value: value, jnp.asarray])
@pytest.mark.parametrize(
    "name, value, says",
    [
        ("rotation", IDENTITY * np.nan, "rotation must be finite"),
        ("rotation", 0 * IDENTITY, "finite and not zero"),
        ("rotation", 2 * MATRIX, "and determinant 1, but it is [[2.0"),
        ("rotation", -MATRIX, "and determinant 1, but it is [[-1.0"),
        ("rotation", MATRIX * np.nan, "and determinant 1, but it is [[nan"),
        ("points", CLOUD * np.inf, "points must be finite"),
        ("translation", np.array([0, 0, np.nan]), "translation must be finite"),
        ("sigma", -1.0, f"{SIGMA} finite, but it is -1.0"),
        ("sigma", np.nan, f"{SIGMA} finite, but it is nan"),
        ("sigma", np.array([1, 1, -1, 1, 1], "f4"), "one is -1.0"),
        ("scale", -1.0, f"{SCALE} and finite, but it is -1.0"),
        ("scale", np.full(5, np.inf, "f4"), "but one is inf"),
        ("scale", 1e308, f"{SCALE} and finite"),
        ("covariance", -MATRICES, "without negative eigenvalues"),
        ("covariance", MATRICES - SINGULAR, "without negative"),
        ("covariance", SINGULAR, "drawn"),
    ],
)
def test_a_number_is_drawn_or_refused(name, value, says, convert, tmp_path):
    sizes = {"sigma": None} if name == "covariance" else {}
    assert_try_says(lambda _: project(**{name: convert(value)} | sizes), says, tmp_path)


FOCAL_LENGTH = "camera.focal_length must be finite and above 0, but"


@tries(f"{FOCAL_LENGTH} it is -1.0", camera=dpc_jax.Camera(-1.0))
@tries(f"{FOCAL_LENGTH} it is 0.0", camera=dpc_jax.Camera(jnp.array(0.0)))
@tries("camera.distance must be finite", camera=dpc_jax.Camera(1.0, np.inf))
@tries("takes 4e+06 GB; make it coarser", grid=dpc_jax.VoxelGrid(100_000))
def project_with(_, **changes):
    return project(**changes)


ZERO = "rotations must be finite and not zero, but one is [0.0, 0.0, 0.0, 0.0]"


@tries(ZERO, rotation=np.stack([IDENTITY, 0 * IDENTITY]))
@tries("sigma must be at least 0", sigma=-1.0)
@tries(f"{FOCAL_LENGTH} one is -1.0", camera=dpc_jax.Camera(np.array([1.0, -1], "f4")))
def project_a_batch(_, **changes):
    changes = {"rotation": np.tile(IDENTITY, (2, 1))} | changes
    return project(**changes, function=dpc_jax.project_batch)


@tries("rotation must be a rotation")
def project_a_mirrored_volume(_):
    return dpc_jax.project_volume(np.ones((2, 2, 2), "f4"), -MATRIX, grid=GRID)


@tries("rotations must be finite and not zero", rotations=np.zeros((1, 4), "f4"))
@tries(FOCAL_LENGTH, camera=dpc_jax.Camera(-1.0))
def fit(_, **changes):
    return dpc_jax.fit(np.full((1, 64, 64), 255, "u1"), **changes)


@tries("True")
def render_traced_numbers_by_the_documented_rule(_):
    """NaN points are left out, a zero quaternion is none, a negative sigma is 0."""

    def render(points, rotation, sigma):
        return dpc_jax.project(points, rotation, sigma=sigma, grid=GRID).silhouette

    spoiled = np.concatenate([CLOUD, np.full((1, 3), np.nan, "f4")])
    image = jax.jit(render)(spoiled, 0 * IDENTITY, -1.0)
    return np.allclose(image, render(CLOUD, IDENTITY, 0.0))


FORWARD = "but forward mode came (jax.jvp, jax.jacfwd, jax.hessian); take jax.jacrev"


def differentiate_under_jit(function):
    return jax.jit(jax.hessian(function))


@tries(FORWARD, transform=jax.jacfwd)
@tries("take jax.jacrev twice for second", transform=differentiate_under_jit)
@tries("but forward mode came", transform=jax.jacfwd, function=dpc_jax.project_batch)
def differentiate(_, *, transform: Callable, function=dpc_jax.project):
    """The derivative of a silhouette by its pose, or the refusal of one."""

    def render(rotation):
        return function(CLOUD, rotation, sigma=1.0, grid=GRID).silhouette

    rotation = jnp.asarray(IDENTITY)
    try:
        transform(render)(rotation if function is dpc_jax.project else rotation[None])
    except TypeError as error:
        return error
    return "differentiated"


@pytest.mark.parametrize("attempt, says", TABLE)
def test_a_call_ends_in_a_result_or_in_a_sentence(attempt, says, tmp_path):
    assert_try_says(attempt, says, tmp_path)
