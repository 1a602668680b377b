"""From points to the volume of their densities, by each method of the paper."""

from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import quaternion, smoothing, splatting
from dpc_jax.render.camera import Camera, VoxelGrid, to_camera_frame, to_grid
from dpc_jax.render.exact import covariances, gaussians


class Scene(NamedTuple):
    """Points in the grid, with what their densities depend on.

    Attributes:
      coordinates: [N, 3] continuous (row, col, depth) index.
      mass: [N] in voxels, zero for a point outside.
      is_inside: [N] bool, which points are in the volume and before the camera.
      sigma: () or [N] in voxels, or None with a covariance.
      covariance: [N, 3, 3] in the grid's axes, voxels², or None.
    """

    coordinates: chex.Array
    mass: chex.Array
    is_inside: chex.Array
    sigma: chex.Array | None
    covariance: chex.Array | None


def place_points(
    points: chex.Array,
    rotation: chex.Array,
    *,
    sigma: chex.Array | None,
    scale: chex.Array,
    covariance: chex.Array | None,
    translation: chex.Array | None,
    camera: Camera,
    grid: VoxelGrid,
) -> Scene:
    """Move points, and their covariances, into the grid; arguments as of `project`."""
    moved = to_camera_frame(points, rotation, translation=translation, camera=camera)
    coordinates, is_inside = to_grid(moved, camera=camera, grid=grid)
    if covariance is not None:
        is_matrix = rotation.shape == (3, 3)
        matrix = rotation if is_matrix else quaternion.to_matrix(rotation)
        # A point outside may lie in the camera plane, where perspective has no slope.
        x, y, _ = jnp.where(is_inside[:, None], moved.centered, 0).T
        safe = jnp.stack([x, y, jnp.where(is_inside, moved.ahead, 1)], axis=-1)
        covariance = covariances.move_covariance(
            covariance, safe, matrix, camera=camera, grid=grid
        )
    mass = jnp.where(is_inside, scale, 0)
    return Scene(coordinates, mass, is_inside, sigma, covariance)


def fill_volume(scene: Scene, colors: chex.Array | None, *, shape, method):
    """Density Σ f_i, and colour densities Σ y_i f_i where colours are given.

    Args:
      colors: [N, C] or None.
      shape: (rows, cols, depth), static.
      method: "trilinear" or "gaussian", static.

    Returns:
      (density [rows, cols, depth], map_colors), where map_colors(function) gives
      [C, ...] of function(Σ y_i f_i [rows, cols, depth]) for each channel. The fast
      method fills one channel at a time and keeps none.
    """
    if method == "trilinear":

        def fill(mass):
            volume = splatting.splat(scene.coordinates, mass, shape)
            return smoothing.smooth(volume, scene.sigma)

        def map_colors(function):
            call = jax.checkpoint(lambda c: function(fill(scene.mass * c)))
            return jax.lax.map(call, colors.T)

        return fill(scene.mass), map_colors

    values = scene.mass[:, None]
    if colors is not None:
        values = jnp.concatenate([values, values * colors], axis=1)
    if scene.covariance is not None:
        volumes = covariances.sum_covariances(
            scene.coordinates,
            values,
            scene.covariance,
            shape=shape,
            is_inside=scene.is_inside,
        )
    else:
        volumes = gaussians.sum_gaussians(
            scene.coordinates,
            values,
            scene.sigma,
            shape=shape,
            is_inside=scene.is_inside,
        )
    return volumes[0], lambda function: jax.vmap(function)(volumes[1:])
