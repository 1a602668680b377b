"""A batch in one call: equal to one at a time, on one device or several.

In float64, so that differences are rounding, on the tests' four CPU devices.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, NamedSharding, PartitionSpec
from tiny_runs import run_python

import dpc_jax
from dpc_jax.render.devices import count_cores

N, D = 20, 8
GRID = dpc_jax.VoxelGrid(D)
SIGNALS = ("silhouette", "depth", "color")


def draw(batch):
    """Clouds [B, N, 3] and poses [B, 4] in float64; call it with x64 enabled."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.35, 0.35, (batch, N, 3))
    return jnp.asarray(points), jnp.asarray(rng.normal(size=(batch, 4)))


def assert_close(found, right):
    assert jax.tree.structure(found) == jax.tree.structure(right)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(right), strict=True):
        assert a.shape == b.shape and a.dtype == b.dtype
        # Some hundred operations in float64.
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * max(1, np.abs(b).max()))


# Signals and their gradients.

RNG = np.random.default_rng(7)
COLORS, SIZES = RNG.uniform(size=(3, N, 2)), RNG.uniform(0.8, 1.6, (3, N))
SHIFTS = RNG.uniform(-0.1, 0.1, (3, 3))
COVARIANCES = np.eye(3) * (1 + SIZES[..., None, None])
LENSES = {"focal_length": np.array([1.5, 1.875, 2.2]), "distance": 2 + SHIFTS[:, 0]}
LENSES |= {"principal_point": SHIFTS[:, :2], "aspect": 1 + SHIFTS[:, 2]}


@pytest.mark.parametrize(
    "own, shared, has_slopes",
    [
        (
            {"sigma": SIZES[:, 0], "translation": SHIFTS}
            | {"camera": dpc_jax.Camera(**LENSES)},
            *({"scale": SIZES[:1]}, True),
        ),
        (
            {"scale": SIZES[:, 1]},
            *({"covariance": COVARIANCES[0], "translation": SHIFTS[0]}, False),
        ),
    ],
)
def test_all_signals_and_their_gradients_are_those_of_one_at_a_time(
    own, shared, has_slopes
):
    """Rank says what all examples share; [1, N] are sizes that they do."""
    own = {"colors": COLORS} | own

    def compute(render, points, rotations, own, shared):
        def sum_all(points, rotations, own):
            options = shared | {"grid": GRID, "signals": SIGNALS}
            images = render(points, rotations, **own, **options)
            parts = [jnp.sum(image**2) for image in jax.tree.leaves(images)]
            return sum(parts), images

        if not has_slopes:
            return sum_all(points, rotations, own)[1]
        return jax.grad(sum_all, (0, 1, 2), has_aux=True)(points, rotations, own)

    with jax.enable_x64(True):
        points, rotations = draw(3)
        batch = functools.partial(compute, render_all)
        found = jax.jit(batch)(points, rotations, own, shared)
        one = jax.jit(functools.partial(compute, dpc_jax.project))
        of_one = {n: v[0] if np.shape(v)[:1] == (1,) else v for n, v in shared.items()}
        examples = [
            one(points[i], rotations[i], jax.tree.map(lambda a, i=i: a[i], own), of_one)
            for i in range(3)
        ]
        assert_close(found, jax.tree.map(lambda *a: jnp.stack(a), *examples))


# Devices.


def render(points, rotations, **options):
    options = {"sigma": 1.2, "grid": GRID} | options
    return dpc_jax.project_batch(points, rotations, **options).silhouette


def render_all(points, rotations, *, translation=None, **options):
    """With the argument's name of `project`."""
    options["translations"] = translation
    return dpc_jax.project_batch(points, rotations, **options)


@jax.jit
def render_one(points, rotation):
    return dpc_jax.project(points, rotation, sigma=1.2, grid=GRID).silhouette


def render_in_turn(points, rotations):
    """Of [B, N, 3], or of one cloud [N, 3] that all views share."""
    points = jnp.broadcast_to(points, (len(rotations), N, 3))
    images = [render_one(p, q) for p, q in zip(points, rotations, strict=True)]
    return jnp.stack(images)


def in_mesh(kind, spec, *inputs):
    mesh = jax.make_mesh((2, 2), ("a", "b"), axis_types=(kind, kind))
    with jax.set_mesh(mesh):
        placed = jax.device_put(inputs, NamedSharding(mesh, spec))
        return jax.jit(render)(*placed)


def in_shard_map(*inputs):
    mesh = jax.make_mesh((2,), ("a",), axis_types=(AxisType.Auto,))
    spec = PartitionSpec("a")
    mapped = jax.shard_map(render, mesh=mesh, in_specs=spec, out_specs=spec)
    return jax.jit(mapped)(*inputs)


def in_groups(mapping, count, *inputs):
    split = [a.reshape(count, -1, *a.shape[1:]) for a in inputs]
    images = mapping(render)(*split)
    return images.reshape(-1, *images.shape[2:])


def on_default_device(*inputs):
    with jax.default_device(jax.devices()[2]):
        return render(*inputs)


def elsewhere(points, rotations):
    return render(jax.device_put(points, jax.devices()[-1]), rotations)


def as_matrices(points, rotations):
    return render(points, jax.vmap(dpc_jax.quaternion.to_matrix)(rotations))


call = functools.partial
HALF, WHOLE = PartitionSpec("a"), PartitionSpec()


@pytest.mark.parametrize(
    "batch, find, devices",
    [
        pytest.param(2, as_matrices, 2, id="fewer than devices, and matrices"),
        pytest.param(1, render, 1, id="one"),
        pytest.param(5, call(render, renders_at_once=2), 3, id="two each, at once"),
        pytest.param(9, jax.jit(render), 3, id="compiled, three each"),
        pytest.param(8, lambda *i: render(*i, devices=jax.devices()[2:]), 2, id="two"),
        pytest.param(8, elsewhere, 4, id="arrays elsewhere"),
        pytest.param(8, on_default_device, 1, id="default device"),
        pytest.param(8, call(in_mesh, AxisType.Auto, HALF), 4, id="mesh"),
        pytest.param(8, call(in_mesh, AxisType.Explicit, HALF), 4, id="explicit mesh"),
        pytest.param(5, call(in_mesh, AxisType.Explicit, WHOLE), 4, id="its rest"),
        pytest.param(8, in_shard_map, 2, id="shard_map"),
        pytest.param(8, call(in_groups, jax.pmap, 4), None, id="pmap"),
        pytest.param(8, call(in_groups, jax.vmap, 2), None, id="vmap"),
    ],
)
def test_a_batch_is_that_of_one_at_a_time(batch, find, devices):
    with jax.enable_x64(True):
        inputs = draw(batch)
        found = find(*inputs)
        assert_close(found, render_in_turn(*inputs))
    assert devices is None or len(found.sharding.device_set) == devices


def test_the_gradient_to_what_all_share_is_the_sum_over_uneven_shares():
    def differentiate(render, *inputs):
        return jax.grad(lambda pair: jnp.sum(render(*pair) ** 2))(inputs)

    with jax.enable_x64(True):
        points, rotations = draw(5)
        found = jax.jit(functools.partial(differentiate, render))(points[0], rotations)
        assert_close(found, differentiate(render_in_turn, points[0], rotations))


def test_of_no_examples_there_are_no_images_and_no_slope():
    with jax.enable_x64(True):
        points, rotations = draw(1)[0][0], jnp.zeros((0, 4))
        assert render(points, rotations).shape == (0, D, D)
        slope = jax.grad(lambda p: jnp.sum(render(p, rotations)))(points)
    np.testing.assert_array_equal(slope, np.zeros((N, 3)))


def test_devices_are_not_named_inside_a_mesh():
    mesh = jax.make_mesh((1,), ("a",), axis_types=(AxisType.Auto,))
    with jax.set_mesh(mesh), pytest.raises(ValueError, match="devices must be None"):
        render(*draw(1), devices=jax.devices()[:1])


def test_cores_cannot_become_devices_once_jax_has_started():
    jax.devices()
    assert dpc_jax.use_all_cores(1) >= 1  # as many as there are
    with pytest.raises(RuntimeError, match="JAX_NUM_CPU_DEVICES=1000 before Python"):
        dpc_jax.use_all_cores(1000)


@pytest.mark.parametrize("before, found", [("3", 3), (None, count_cores())])
def test_all_cores_are_those_of_the_process_unless_the_environment_says(before, found):
    code = "import dpc_jax, jax; n = dpc_jax.use_all_cores(); "
    code += "print(n, len(jax.devices('cpu')))"
    done = run_python("-c", code, JAX_NUM_CPU_DEVICES=before)
    assert done.stdout.split() == [str(found)] * 2, done.stderr
