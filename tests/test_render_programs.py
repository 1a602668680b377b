"""The compiled programs of `project`: batching, dtypes, and only what is asked for."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dpc_jax


def test_vmap_map_and_a_loop_agree():
    points = jnp.asarray(np.random.default_rng(0).uniform(-0.3, 0.3, (3, 10, 3)), "f4")
    poses = jnp.asarray(np.random.default_rng(1).normal(size=(3, 4)), "f4")

    def render(arguments):
        grid = dpc_jax.VoxelGrid(10)
        return dpc_jax.project(*arguments, sigma=1.0, grid=grid).silhouette

    one = jax.jit(render)
    mapped = jax.jit(lambda pairs: jax.lax.map(render, pairs))((points, poses))
    vmapped = jax.jit(jax.vmap(render))((points, poses))
    looped = jnp.stack([one(pair) for pair in zip(points, poses, strict=True)])
    np.testing.assert_allclose(vmapped, mapped, atol=1e-6)  # order of float32 sums
    np.testing.assert_allclose(looped, mapped, atol=1e-6)


@pytest.mark.parametrize("points_dtype", ["float32", "float64"])
@pytest.mark.parametrize("other_dtype", ["float32", "float64"])
def test_the_dtype_of_the_points_decides_that_of_every_image(points_dtype, other_dtype):
    @jax.jit
    def render(points, rotation, others):
        sigma, scale, translation, colors, focal_length, distance = others
        return dpc_jax.project(
            points,
            rotation,
            sigma=sigma,
            scale=scale,
            translation=translation,
            colors=colors,
            camera=dpc_jax.Camera(focal_length, distance),
            grid=dpc_jax.VoxelGrid(4),
            signals=("silhouette", "depth", "color"),
        )

    shapes = ((), (2,), (3,), (2, 1), (), ())
    with jax.enable_x64(True):
        image = jax.eval_shape(
            render,
            jax.ShapeDtypeStruct((2, 3), points_dtype),
            jax.ShapeDtypeStruct((4,), other_dtype),
            [jax.ShapeDtypeStruct(shape, other_dtype) for shape in shapes],
        )
    assert image.silhouette.dtype == points_dtype
    assert image.depth.dtype == points_dtype
    assert image.color.dtype == points_dtype


@pytest.mark.parametrize("signal", ["silhouette", "depth", "color"])
def test_only_the_signal_asked_for_comes_back(signal):
    image = jax.eval_shape(
        lambda points: dpc_jax.project(
            points, jnp.eye(3), sigma=1, colors=points, signals=(signal,)
        ),
        jnp.zeros((1, 3)),
    )
    given = {n for n in ("silhouette", "depth", "color") if image[n] is not None}
    assert given == {signal}


def count_flops(signals, colors=None):
    function = functools.partial(
        dpc_jax.project, sigma=1.5, grid=dpc_jax.VoxelGrid(16), signals=signals
    )
    arguments = (jnp.zeros((20, 3)), jnp.zeros(4))
    lowered = jax.jit(lambda p, q: function(p, q, colors=colors)).lower(*arguments)
    text = lowered.as_text()
    return lowered.compile().cost_analysis()["flops"], text


def test_the_compiled_silhouette_holds_neither_probabilities_nor_colours():
    colors = jnp.ones((20, 3))
    silhouette, text = count_flops(("silhouette",), colors)
    assert "cumprod" not in text
    depth, depth_text = count_flops(("depth",), colors)
    assert "cumprod" in depth_text
    color, color_text = count_flops(("color",), colors)
    assert silhouette < depth < color
    # Each of the three channels is one more volume to splat.
    assert color_text.count("scatter") > depth_text.count("scatter")


def test_a_second_call_with_another_sigma_compiles_nothing():
    render = jax.jit(
        lambda p, q, s: (
            dpc_jax.project(p, q, sigma=s, grid=dpc_jax.VoxelGrid(6)).silhouette
        )
    )
    for sigma in (0.0, 0.5, 3.0):
        render(jnp.zeros((2, 3)), jnp.ones(4), sigma)
    assert render._cache_size() == 1
