"""The projection as one would first write it in JAX.

The same silhouettes by the same steps as the engine: each point adds to its eight
neighbours, products with the kernel's Toeplitz matrix smooth the volume, and a product
along each ray has its own derivative rule. Only the rotation and the camera are taken
from the engine.
"""

import itertools

import jax
import jax.numpy as jnp

from dpc_jax.render.camera import Camera, VoxelGrid, to_camera_frame, to_grid

CORNERS = tuple(itertools.product((0, 1), repeat=3))

Sample = tuple[jax.Array, jax.Array, jax.Array]
"""Points [N, 3], rotation [4] and mass () in voxels of one cloud."""


def render_plain(sample: Sample, sigma: jax.Array, *, side: int) -> jax.Array:
    """Silhouette [side, side] of one cloud; sigma in voxels."""
    points, rotation, mass = sample
    camera = Camera()
    moved = to_camera_frame(points, rotation, translation=None, camera=camera)
    coordinates, is_inside = to_grid(moved, camera=camera, grid=VoxelGrid(side))
    first = jnp.floor(coordinates)
    fraction = coordinates - first
    first = first.astype(jnp.int32) + 1  # a border of one cell catches the outside
    padded = side + 2
    volume = jnp.zeros(padded**3)
    for corner in CORNERS:
        weight = jnp.where(is_inside, mass, 0)
        for axis, is_upper in enumerate(corner):
            part = fraction[:, axis]
            weight = weight * (part if is_upper else 1 - part)
        row, col, depth = (first + jnp.array([corner])).T
        volume = volume.at[(row * padded + col) * padded + depth].add(weight)
    volume = volume.reshape(padded, padded, padded)[1:-1, 1:-1, 1:-1]

    cells = jnp.arange(side)
    far = jnp.arange(-4 * side, 4 * side + 1)
    kernel = jnp.exp(-0.5 * ((cells[:, None] - cells[None]) / sigma) ** 2)
    kernel = kernel / jnp.sum(jnp.exp(-0.5 * (far / sigma) ** 2))
    volume = jnp.matmul(kernel, volume @ kernel)
    volume = (kernel @ volume.reshape(side, -1)).reshape(volume.shape)
    return _end_rays(jnp.clip(volume, 0, 1))


@jax.custom_vjp
def _end_rays(occupancy):
    return 1 - jnp.prod(1 - occupancy, axis=-1)


def _end_rays_forward(occupancy):
    return _end_rays(occupancy), occupancy


def _end_rays_backward(occupancy, cotangent):
    """Product of all other factors: by division, except where a factor is zero."""
    free = 1 - occupancy
    is_zero = free == 0
    zeros = jnp.sum(is_zero, axis=-1, keepdims=True)
    safe = jnp.where(is_zero, 1, free)
    product = jnp.prod(safe, axis=-1, keepdims=True)
    lone = jnp.where(is_zero & (zeros == 1), product, 0)
    others = jnp.where(zeros == 0, product / safe, lone)
    return (others * cotangent[..., None],)


_end_rays.defvjp(_end_rays_forward, _end_rays_backward)
