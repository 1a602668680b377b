"""Batches on the tests' four CPU devices, beside one example at a time.

In float64, so that differences are rounding.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, NamedSharding, PartitionSpec

import dpc_jax

N = 20
GRID = dpc_jax.VoxelGrid(8)


def draw(batch):
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.35, 0.35, (batch, N, 3))
    return jnp.asarray(points), jnp.asarray(rng.normal(size=(batch, 4)))


def render(points, rotations, **options):
    options = {"sigma": 1.2, "grid": GRID} | options
    return dpc_jax.project_batch(points, rotations, **options).silhouette


@jax.jit
def render_one(points, rotation):
    return dpc_jax.project(points, rotation, sigma=1.2, grid=GRID).silhouette


def render_in_turn(points, rotations):
    """Of [B, N, 3], or of one cloud [N, 3] that all views share."""
    points = jnp.broadcast_to(points, (len(rotations), N, 3))
    images = [render_one(p, q) for p, q in zip(points, rotations, strict=True)]
    return jnp.stack(images)


def differentiate(render, *inputs):
    return jax.grad(lambda pair: jnp.sum(render(*pair) ** 2))(inputs)


def in_mesh(kind, inputs, *, spec):
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


def give(**options):
    return functools.partial(render, **options)


def place(kind, spec):
    return lambda *inputs: in_mesh(kind, inputs, spec=spec)


HALF, WHOLE = PartitionSpec("a"), PartitionSpec()


@pytest.mark.parametrize(
    "batch, find, devices",
    [
        pytest.param(8, render, 4, id="as many each"),
        pytest.param(5, render, 3, id="not divisible: two each"),
        pytest.param(2, render, 2, id="fewer than devices"),
        pytest.param(1, render, 1, id="one"),
        pytest.param(8, give(renders_at_once=0), 4, id="all at once"),
        pytest.param(5, give(renders_at_once=2), 3, id="two at once"),
        pytest.param(5, jax.jit(render), 3, id="compiled"),
        pytest.param(8, lambda *i: give(devices=jax.devices()[:2])(*i), 2, id="two"),
        pytest.param(8, lambda *i: give(devices=jax.devices()[3:])(*i), 1, id="fourth"),
        pytest.param(8, elsewhere, 4, id="arrays elsewhere"),
        pytest.param(8, on_default_device, 1, id="default device"),
        pytest.param(8, place(AxisType.Auto, HALF), 4, id="mesh"),
        pytest.param(8, place(AxisType.Explicit, HALF), 4, id="explicit mesh"),
        pytest.param(5, place(AxisType.Explicit, WHOLE), 4, id="its rest"),
        pytest.param(8, in_shard_map, 2, id="shard_map"),
        pytest.param(8, functools.partial(in_groups, jax.pmap, 4), None, id="pmap"),
        pytest.param(8, functools.partial(in_groups, jax.vmap, 2), None, id="vmap"),
    ],
)
def test_a_batch_is_that_of_one_at_a_time(batch, find, devices):
    with jax.enable_x64(True):
        inputs = draw(batch)
        found, right = find(*inputs), render_in_turn(*inputs)
    # Some hundred operations in float64.
    np.testing.assert_allclose(found, right, rtol=0, atol=1e-12)
    assert devices is None or len(found.sharding.device_set) == devices


@pytest.mark.parametrize("is_compiled", [False, True])
@pytest.mark.parametrize("is_shared", [False, True])
def test_its_gradient_is_that_of_one_at_a_time(is_compiled, is_shared):
    with jax.enable_x64(True):
        points, rotations = draw(5)
        inputs = points[0] if is_shared else points, rotations
        find = functools.partial(differentiate, render)
        found = (jax.jit(find) if is_compiled else find)(*inputs)
        right = differentiate(render_in_turn, *inputs)
    for slope, expected in zip(found, right, strict=True):
        atol = 1e-12 * np.abs(expected).max()
        np.testing.assert_allclose(slope, expected, rtol=0, atol=atol)
