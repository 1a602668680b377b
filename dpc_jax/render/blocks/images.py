"""Images of a scene whose volume is stored as touched blocks."""

import functools

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render.blocks import rays, touched
from dpc_jax.render.blocks.filling import sum_densities
from dpc_jax.render.camera import Camera, VoxelGrid
from dpc_jax.render.volume import Scene, clip_unit, map_channels


def render_blocks(
    scene: Scene,
    colors: jax.Array | None,
    camera: Camera,
    grid: VoxelGrid,
    signals: tuple[str, ...],
    background: tuple[chex.Numeric, chex.Numeric],
    max_blocks: int,
) -> tuple[dict[str, jax.Array], jax.Array]:
    """Eq. 3 to 5 for one sigma, without the space that no point reaches.

    Arguments as of `project`, with room for `max_blocks` blocks (static).

    Returns:
      (images by the name of their signal, () bool whether they are right: the blocks
      found room, and the smoothing reaches no further than the next block).
    """
    shape = grid.shape
    blocks = touched.find_blocks(scene, shape, max_blocks)
    is_right = blocks.count <= max_blocks
    fill = functools.partial(sum_densities, scene, blocks=blocks, shape=shape)
    density = fill(scene.mass)
    occupancy = clip_unit(density)
    rows, cols, depth = touched.divide(shape)
    columns = rays.Columns(blocks.ids // depth, rows * cols, depth)
    images = {}
    if "silhouette" in signals:
        united = rays.opacity(occupancy, columns)
        images["silhouette"] = rays.lay_out_image(united, shape)
    if set(signals) == {"silhouette"}:
        return images, is_right

    found = rays.end_rays(occupancy, columns)
    behind = rays.lay_out_image(found.background, shape)
    background_depth, background_color = background
    if "depth" in signals:
        cells = touched.find_depths(blocks.ids, shape).clip(0, shape[2] - 1)
        depths = grid.depths(camera, density.dtype)[cells][:, :, None, None]
        ahead = columns.add_up(jnp.sum(found.ends * depths, axis=1))
        beyond = behind * jnp.asarray(background_depth, density.dtype)
        images["depth"] = rays.lay_out_image(ahead, shape) + beyond
    if colors is not None:
        weight = found.reached / jnp.where(density > 1, density, 1)

        def sum_channel(channel):
            return columns.add_up(jnp.sum(weight * fill(scene.mass * channel), axis=1))

        ahead = jnp.moveaxis(map_channels(sum_channel, colors), 0, -1)
        color = jnp.asarray(background_color, density.dtype).reshape(1, 1, -1)
        beyond = behind[..., None] * color
        images["color"] = rays.lay_out_image(ahead, shape) + beyond
    return images, is_right
