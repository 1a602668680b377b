"""A pull on points that lie outside of the silhouettes. Not in the paper.

A point alone in an empty part of an image has next to no gradient from the squares of
silhouettes: wherever it moves, the image around it stays as blank. So it hangs there.
The distance to the silhouette tells it where to go.
"""

import jax
import jax.numpy as jnp

from dpc_jax.learning.cameras import Cameras, list_own, place_camera
from dpc_jax.learning.losses import downsample_images
from dpc_jax.render import Camera, quaternion

_NEAREST = 0.1  # to the camera, of points that are told anything, box diagonals


def measure_outside(silhouette: jax.Array) -> jax.Array:
    """Distance of each pixel from the nearest one that is covered by half or more.

    The exact Euclidean distance, one axis after the other. Where nothing is covered it
    is that to the far end of an image twice as large, everywhere.

    Args:
      silhouette: [D, D].

    Returns:
      [D, D], in widths of the image; 0 where it is covered.
    """
    side = silhouette.shape[-1]
    steps = jnp.arange(side)
    squares = ((steps[:, None] - steps[None]) ** 2).astype(silhouette.dtype)
    far = jnp.where(silhouette >= 0.5, 0, 2.0 * side**2)
    by_rows = jnp.min(far[None] + squares[:, :, None], axis=1)
    both = jnp.min(by_rows[:, None] + squares[None], axis=2)
    return jnp.sqrt(jnp.minimum(both, 2.0 * side**2)) / side


def pull_inside(
    points: jax.Array,
    rotation: jax.Array,
    outside: jax.Array,
    *,
    camera: Camera,
    translation: jax.Array | None = None,
) -> jax.Array:
    """Mean distance of projected points from a silhouette, in image widths; ().

    Of points beside the image it is the border's, and the way there along both axes;
    those behind the camera or just before it are told nothing.

    Args:
      points: [N, 3]. rotation: [4].
      outside: [D, D] of `measure_outside`.
      camera, translation: see `project`.
    """
    side = outside.shape[-1]
    moved = quaternion.rotate(points, rotation)
    if translation is not None:
        moved = moved + translation[None]
    ahead = moved[:, 2] + camera.distance
    is_seen = ahead > _NEAREST
    depth = camera.distance if camera.projection == "orthographic" else ahead
    zoom = camera.focal_length / jnp.where(is_seen, depth, 1)
    places = (moved[:, :2] * zoom[:, None] + 0.5) * side - 0.5  # column, row
    inside = jnp.clip(places, 0, side - 1)
    column, row = inside.T
    distances = jax.scipy.ndimage.map_coordinates(
        outside, [row, column], order=1, mode="nearest"
    )
    beside = jnp.sum(jnp.abs(places - inside), axis=1) / side
    return jnp.mean(jnp.where(is_seen, distances + beside, 0))


def pull_batch(
    points: jax.Array,
    rotations: jax.Array,
    masks: jax.Array,
    *,
    side: int,
    camera: Camera,
    cameras: Cameras,
) -> jax.Array:
    """`pull_inside` of a batch in the mean, with a gradient to the points alone; ().

    Args:
      points: [B, N, 3]. rotations: [B, V, 4].
      masks: uint8 [B, V, S, S]. side: that distances are measured at.
      camera: of all views; cameras [B, V, ...] what they have of their own.
    """
    views = masks.shape[0] * masks.shape[1]
    silhouettes = downsample_images(masks, side).reshape(views, side, side)
    own = {"rotation": rotations.reshape(-1, 4), **list_own(cameras, views)}

    def measure(points, view, silhouette):
        return pull_inside(
            points,
            view["rotation"],
            measure_outside(silhouette),
            camera=place_camera(camera, view),
            translation=view.get("translation"),
        )

    shared = jnp.repeat(points, masks.shape[1], axis=0)
    return jnp.mean(jax.vmap(measure)(shared, jax.lax.stop_gradient(own), silhouettes))
