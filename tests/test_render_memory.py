"""What a call will take, told beforehand."""

import jax
import jax.numpy as jnp

import dpc_jax

N, D = 200, 16
POINTS = jax.ShapeDtypeStruct((N, 3), "float32")
ROTATION = jax.ShapeDtypeStruct((4,), "float32")
GRID = dpc_jax.VoxelGrid(D)
VOLUME = 4 * (D + 2) ** 3  # bytes of one, with a border
# Of a tuple of results the compiler counts the pointers too.
POINTERS = 64


def test_inputs_and_images_are_counted_to_the_byte():
    """Of arrays, lists and numbers, or of what stands for them."""
    sizes = dpc_jax.estimate_memory(POINTS, ROTATION, sigma=1.0, grid=GRID)
    numbers = 4 * 4  # sigma alone, or with the camera's; none is larger
    assert 4 * (3 * N + 4) <= sizes.arguments <= 4 * (3 * N + 4) + numbers
    assert 4 * D * D <= sizes.outputs <= 4 * D * D + POINTERS
    assert sizes.total == sizes.arguments + sizes.outputs + sizes.temporary
    arrays = jnp.zeros((N, 3), "f4"), [1.0, 0, 0, 0]
    assert sizes == dpc_jax.estimate_memory(*arrays, sigma=1, grid=GRID)


def test_a_gradient_comes_with_the_size_of_every_array_it_is_taken_to():
    sizes = dpc_jax.estimate_memory(
        POINTS,
        ROTATION,
        sigma=jax.ShapeDtypeStruct((), "float32"),
        scale=jax.ShapeDtypeStruct((N,), "float32"),
        grid=GRID,
        gradient=True,
    )
    gradients = 4 * (3 * N + 4 + 1 + N)
    expected = 4 * D * D + gradients
    assert expected <= sizes.outputs <= expected + POINTERS
    # The cotangent of the image comes in.
    assert sizes.arguments >= gradients + 4 * D * D
    # No stack of volumes: the density, its smoothing passes and its cotangent.
    assert VOLUME <= sizes.temporary <= 9 * VOLUME  # 5.8 when written


def test_blocks_take_less_memory():
    size = jax.ShapeDtypeStruct((), "float32")
    temporary = [
        dpc_jax.estimate_memory(
            *(POINTS, ROTATION),
            sigma=size,
            grid=dpc_jax.VoxelGrid(264),  # the whole volume does not step in
            max_blocks=max_blocks,
            gradient=True,
        ).temporary
        for max_blocks in (None, 300)
    ]
    # 300 of 35,937 blocks.
    assert temporary[1] < temporary[0] / 8
