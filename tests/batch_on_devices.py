"""Batches on four CPU devices, beside one example at a time; run by a test.

A process of its own, because JAX counts its devices once, when it starts. Prints a line
of JSON: for each case the largest difference, relative to the largest value, and on how
many devices the result lay. Everything is float64, so that differences are rounding.
"""

import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec

import dpc_jax

DEVICES = 4
N = 20
GRID = dpc_jax.VoxelGrid(8)


def draw(batch, *, seed=0):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.35, 0.35, (batch, N, 3))
    return jnp.asarray(points), jnp.asarray(rng.normal(size=(batch, 4)))


def render(points, rotations, **options):
    options = {"sigma": 1.2, "grid": GRID} | options
    images = dpc_jax.project_batch(points, rotations, **options)
    return images.silhouette


@jax.jit
def render_one(points, rotation):
    return dpc_jax.project(points, rotation, sigma=1.2, grid=GRID).silhouette


def render_in_turn(points, rotations):
    images = [render_one(p, q) for p, q in zip(points, rotations, strict=True)]
    return jnp.stack(images)


def sum_squares(render, points, rotations):
    return jnp.sum(render(points, rotations) ** 2)


def differentiate(render, inputs):
    return jax.grad(lambda pair: sum_squares(render, *pair))(inputs)


def render_for_all(points, rotations):
    """One cloud that all views share."""
    images = [render_one(points, q) for q in rotations]
    return jnp.stack(images)


def in_mesh(kind, inputs, *, spec):
    mesh = jax.make_mesh((2, 2), ("a", "b"), axis_types=(kind, kind))
    with jax.set_mesh(mesh):
        placed = jax.device_put(inputs, NamedSharding(mesh, spec))
        return jax.jit(render)(*placed)


def in_shard_map(inputs):
    mesh = jax.make_mesh((2,), ("a",), axis_types=(AxisType.Auto,))
    spec = PartitionSpec("a")
    mapped = jax.shard_map(render, mesh=mesh, in_specs=spec, out_specs=spec)
    return jax.jit(mapped)(*inputs)


def in_pmap(inputs):
    split = [a.reshape(4, 2, *a.shape[1:]) for a in inputs]
    images = jax.pmap(render)(*split)
    return images.reshape(8, *images.shape[2:])


def in_vmap(inputs):
    split = [a.reshape(2, 4, *a.shape[1:]) for a in inputs]
    images = jax.vmap(render)(*split)
    return images.reshape(8, *images.shape[2:])


def with_default_device(inputs):
    with jax.default_device(jax.devices()[2]):
        return render(*inputs)


def list_cases():
    """Name: (what was found, what is right), as functions."""
    eight, five, two = draw(8), draw(5), draw(2)
    shared = five[0][0], five[1]
    first, last = jax.devices()[0], jax.devices()[-1]
    elsewhere = jax.device_put(eight[0], last), eight[1]
    half, whole = PartitionSpec("a"), PartitionSpec()
    turns = functools.partial(render_in_turn, *eight)
    return {
        "as many each": (lambda: render(*eight), turns),
        "not divisible": (lambda: render(*five), lambda: render_in_turn(*five)),
        "fewer than devices": (lambda: render(*two), lambda: render_in_turn(*two)),
        "one": (
            lambda: render(two[0][:1], two[1][:1]),
            lambda: render_in_turn(two[0][:1], two[1][:1]),
        ),
        "all at once": (lambda: render(*eight, renders_at_once=0), turns),
        "two at once": (
            lambda: render(*five, renders_at_once=2),
            lambda: render_in_turn(*five),
        ),
        "compiled": (lambda: jax.jit(render)(*five), lambda: render_in_turn(*five)),
        "gradient": (
            lambda: differentiate(render, five),
            lambda: differentiate(render_in_turn, five),
        ),
        "compiled gradient": (
            lambda: jax.jit(functools.partial(differentiate, render))(five),
            lambda: differentiate(render_in_turn, five),
        ),
        "gradient of what is shared": (
            lambda: differentiate(render, shared),
            lambda: differentiate(render_for_all, shared),
        ),
        "two devices": (lambda: render(*eight, devices=jax.devices()[:2]), turns),
        "another device": (lambda: render(*eight, devices=[last]), turns),
        "arrays elsewhere": (lambda: render(*elsewhere), turns),
        "default device": (lambda: with_default_device(eight), turns),
        "mesh": (lambda: in_mesh(AxisType.Auto, eight, spec=half), turns),
        "explicit mesh": (lambda: in_mesh(AxisType.Explicit, eight, spec=half), turns),
        "explicit mesh, not divisible": (
            lambda: in_mesh(AxisType.Explicit, five, spec=whole),
            lambda: render_in_turn(*five),
        ),
        "shard_map": (lambda: in_shard_map(eight), turns),
        "pmap": (lambda: in_pmap(eight), turns),
        "vmap": (lambda: in_vmap(eight), turns),
        "nothing": (
            lambda: render(eight[0][:0], eight[1][:0]),
            lambda: jax.device_put(jnp.zeros((0, 8, 8)), first),
        ),
    }


def measure_difference(found, right):
    found, right = np.asarray(found), np.asarray(right)
    assert found.shape == right.shape, (found.shape, right.shape)
    return float(np.max(np.abs(found - right), initial=0) / np.max(right, initial=1e-9))


def main():
    assert dpc_jax.use_all_cores(DEVICES) == DEVICES
    results = {}
    for name, (find, compute) in list_cases().items():
        found, right = jax.tree.leaves(find()), jax.tree.leaves(compute())
        assert len(found) == len(right)
        differences = map(measure_difference, found, right)
        devices = len(found[0].sharding.device_set)
        results[name] = {"difference": max(differences), "devices": devices}
    print(json.dumps(results))


if __name__ == "__main__":
    main()
