"""A batch in one call: equal to one at a time, on one device or several."""

import functools
import os
import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax
from dpc_jax.render import devices

B, N, D, C = 3, 12, 8, 2
GRID = dpc_jax.VoxelGrid(D)
RNG = np.random.default_rng(7)
POINTS = RNG.uniform(-0.35, 0.35, (B, N, 3)).astype("f4")
QUATERNIONS = RNG.normal(size=(B, 4)).astype("f4")
COLORS = RNG.uniform(size=(B, N, C)).astype("f4")
SIZES = RNG.uniform(0.8, 1.6, (B, N)).astype("f4")
SHIFTS = RNG.uniform(-0.1, 0.1, (B, 3)).astype("f4")
COVARIANCES = (np.eye(3) * (1 + SIZES[..., None, None])).astype("f4")
# float32: sums of some dozen terms of order one, in another order.
ROUNDING = 3e-6
SIGNALS = ("silhouette", "depth", "color")


def sum_images(images):
    weights = {"silhouette": 1.0, "depth": 0.3, "color": 0.7}
    return sum(w * jnp.sum(images[n] ** 2) for n, w in weights.items())


def assert_close(found, right):
    assert jax.tree.structure(found) == jax.tree.structure(right)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(right), strict=True):
        assert a.shape == b.shape and a.dtype == b.dtype
        np.testing.assert_allclose(a, b, rtol=0, atol=ROUNDING * np.abs(b).max())


@pytest.mark.parametrize(
    "own, shared",
    [
        ({"sigma": SIZES[:, 0], "scale": SIZES[:, 1]}, {}),
        pytest.param(
            {"sigma": SIZES, "scale": SIZES, "translation": SHIFTS},
            {},
            marks=pytest.mark.slow,
        ),
        pytest.param({"covariance": COVARIANCES}, {}, marks=pytest.mark.slow),
        ({}, {"sigma": 1.0, "translation": SHIFTS[0]}),
    ],
    ids=["trilinear", "gaussian", "covariance", "shared"],
)
def test_all_signals_and_their_gradients_are_those_of_one_at_a_time(own, shared):
    own = {"colors": COLORS} | own
    options = shared | {"grid": GRID, "signals": SIGNALS}

    def compute(render, points, rotations, own):
        def sum_all(points, rotations, own):
            images = render(points, rotations, **own, **options)
            return sum_images(images), images

        values = points, rotations, own
        slopes, images = jax.grad(sum_all, (0, 1, 2), has_aux=True)(*values)
        return images, slopes

    found = jax.jit(functools.partial(compute, dpc_jax.project_batch))
    one = jax.jit(functools.partial(compute, dpc_jax.project))
    batch, pairs = (POINTS, QUATERNIONS, own), zip(POINTS, QUATERNIONS, strict=True)
    examples = [
        one(p, q, {n: own[n][i] for n in own}) for i, (p, q) in enumerate(pairs)
    ]
    assert_close(found(*batch), jax.tree.map(lambda *a: jnp.stack(a), *examples))


def test_rank_says_what_all_examples_share():
    def render(points, rotations, **options):
        options = {"sigma": 1.0, "grid": GRID, "colors": COLORS} | options
        return dpc_jax.project_batch(points, rotations, signals=SIGNALS, **options)

    def repeat(value):
        return jnp.repeat(jnp.asarray(value)[None], B, axis=0)

    one, other = POINTS[0], {"sigma": SIZES[0], "scale": SIZES[1]}
    shared = {name: value[None] for name, value in other.items()}
    shared |= {"colors": COLORS[0], "translation": SHIFTS[0]}
    own = {name: repeat(value) for name, value in other.items()}
    own |= {"colors": repeat(COLORS[0]), "translation": repeat(SHIFTS[0])}
    assert_close(
        render(one, QUATERNIONS, **shared), render(repeat(one), QUATERNIONS, **own)
    )
    covariance = {"sigma": None, "covariance": COVARIANCES[0]}
    assert_close(
        render(POINTS, QUATERNIONS, **covariance),
        render(POINTS, QUATERNIONS, sigma=None, covariance=repeat(COVARIANCES[0])),
    )


def test_every_example_may_have_a_camera_of_its_own():
    focal_lengths, distances = [1.5, 1.875, 2.2], [1.8, 2.0, 2.4]
    camera = dpc_jax.Camera(jnp.array(focal_lengths), jnp.array(distances))
    found = dpc_jax.project_batch(
        POINTS, QUATERNIONS, sigma=1.0, camera=camera, grid=GRID
    ).silhouette
    for image, points, rotation, *numbers in zip(
        found, POINTS, QUATERNIONS, focal_lengths, distances, strict=True
    ):
        one = dpc_jax.project(
            points, rotation, sigma=1.0, camera=dpc_jax.Camera(*numbers), grid=GRID
        )
        assert_close(image, one.silhouette)


def test_matrices_are_rotations_too():
    matrices = jax.vmap(dpc_jax.quaternion.to_matrix)(QUATERNIONS)
    assert_close(
        dpc_jax.project_batch(POINTS, matrices, sigma=1.0, grid=GRID),
        dpc_jax.project_batch(POINTS, QUATERNIONS, sigma=1.0, grid=GRID),
    )


def test_of_no_examples_there_are_no_images_and_no_slope():
    def render(points):
        return dpc_jax.project_batch(points, np.zeros((0, 4)), sigma=1.0, grid=GRID)

    assert render(POINTS[0]).silhouette.shape == (0, D, D)
    slope = jax.grad(lambda points: jnp.sum(render(points).silhouette))(POINTS[0])
    np.testing.assert_array_equal(slope, np.zeros((N, 3)))


def call(points=POINTS, rotations=QUATERNIONS, **options):
    options = {"sigma": 1.0, "grid": GRID} | options
    return dpc_jax.project_batch(points, rotations, **options)


@pytest.mark.parametrize(
    "options, said",
    [
        (
            {"rotations": QUATERNIONS[0]},
            "rotations must have shape [B, 4] or [B, 3, 3]",
        ),
        ({"points": POINTS[:2]}, "points must have shape [N, 3] or [3, N, 3]"),
        ({"sigma": SIZES[0]}, "[B, N] one for each point, or [1, N]"),
        ({"scale": SIZES[:2]}, "scale must have shape () or [3] or [3, 12] or [1, 12]"),
        ({"covariance": COVARIANCES[:2]}, "covariance must have shape [12, 3, 3] or"),
        ({"colors": COLORS[:2]}, "colors must have shape [12, C] or [3, 12, C]"),
        ({"translation": SHIFTS[:2]}, "translation must have shape [3] or [3, 3]"),
        (
            {"camera": dpc_jax.Camera(np.ones(2))},
            "camera.focal_length must have shape () or [3]",
        ),
        ({"camera": None}, "camera must be a dpc_jax.Camera"),
        ({"sigma": None}, "both sigma and covariance are None"),
        ({"sigma": SIZES, "method": "trilinear"}, "sigma must be one number with"),
        ({"signals": ("color",)}, "must have colors of shape"),
        ({"signals": "depth"}, "signals must be a non-empty tuple"),
        ({"renders_at_once": -2}, "renders_at_once must be an integer of at least -1"),
        ({"renders_at_once": True}, "renders_at_once must be an integer"),
        ({"devices": []}, "devices must be at least one, but none came"),
        ({"points": POINTS.astype(int)}, "points must be floating point numbers"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(options, said):
    with pytest.raises(ValueError, match=re.escape(said)):
        call(**options)


def test_devices_are_not_named_inside_a_mesh():
    mesh = jax.make_mesh((1,), ("a",), axis_types=(jax.sharding.AxisType.Auto,))
    with jax.set_mesh(mesh), pytest.raises(ValueError, match="devices must be None"):
        call(devices=jax.devices()[:1])


@pytest.mark.parametrize(
    "batch_size, count, needed", [(8, 4, 4), (5, 4, 3), (9, 4, 3), (2, 4, 2), (1, 4, 1)]
)
def test_no_more_devices_are_taken_than_shorten_the_time(batch_size, count, needed):
    chosen = devices.choose_mesh(jax.devices()[:1] * count, batch_size=batch_size)
    assert chosen is not None
    assert chosen.size == needed
    assert -(-batch_size // needed) == -(-batch_size // count)


def test_cores_cannot_become_devices_once_jax_has_started():
    jax.devices()
    assert dpc_jax.use_all_cores(1) >= 1  # as many as there are
    with pytest.raises(RuntimeError, match="JAX_NUM_CPU_DEVICES=1000 before Python"):
        dpc_jax.use_all_cores(1000)


@pytest.mark.parametrize("count", [0, -1, True, 1.5, "2"])
def test_only_a_positive_count_of_cores_is_taken(count):
    with pytest.raises(ValueError, match="count must be a positive integer"):
        dpc_jax.use_all_cores(count)


@pytest.mark.parametrize("before, found", [("3", 3), (None, devices.count_cores())])
def test_all_cores_are_those_of_the_process_unless_the_environment_says(before, found):
    environment = {k: v for k, v in os.environ.items() if k != "JAX_NUM_CPU_DEVICES"}
    if before:
        environment["JAX_NUM_CPU_DEVICES"] = before
    code = "import dpc_jax, jax; n = dpc_jax.use_all_cores(); "
    code += "print(n, len(jax.devices('cpu')))"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True
    )
    assert done.stdout.split() == [str(found)] * 2, done.stderr
