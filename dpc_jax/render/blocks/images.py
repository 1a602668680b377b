"""Images of a scene whose volume is stored as touched blocks."""

import functools

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import splines
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
    ray_rule: str,
    background: tuple[chex.Numeric, chex.Numeric],
    max_blocks: int,
) -> tuple[dict[str, jax.Array], jax.Array]:
    """Eq. 3 to 5 for one sigma, without the space that no point reaches.

    Arguments as of `project`, with room for `max_blocks` blocks (static).

    Returns:
      (images by the name of their signal, () bool whether they are right: the blocks
      found room, and the smoothing reaches no further than the next block).
    """
    shape, dtype = grid.shape, scene.coordinates.dtype
    counts, order = touched.divide(shape), splines.ORDERS[scene.method]
    sigma = splines.narrow(jnp.asarray(scene.sigma), order)
    places = scene.coordinates, scene.is_inside, sigma
    blocks = touched.find_blocks(
        *jax.lax.stop_gradient(places), shape, order, max_blocks
    )
    is_narrow = touched.is_narrow(jax.lax.stop_gradient(sigma), dtype, order)
    is_right = (blocks.count <= max_blocks) & is_narrow

    def fill(mass):
        density = sum_densities(scene, mass, sigma, blocks, shape)
        if shape[2] % touched.BLOCK == 0:
            return density
        # The last block stands out of the volume.
        cells = _find_depth_cells(blocks.ids, counts)
        return jnp.where((cells < shape[2])[:, :, None, None], density, 0)

    density = fill(scene.mass)
    occupancy = clip_unit(density)
    columns = rays.find_columns(blocks.ids, counts)
    lay_out = functools.partial(rays.lay_out_image, counts=counts, shape=shape)
    images = {}
    if "silhouette" in signals:
        images["silhouette"] = lay_out(
            rays.opacity(occupancy, columns)
            if ray_rule == "termination"
            else rays.fullest(occupancy, columns, shape[2])
        )
    if set(signals) == {"silhouette"}:
        return images, is_right

    found = rays.end_rays(occupancy, columns)
    behind = lay_out(found.background)
    background_depth, background_color = background
    if "termination" in signals:
        images["termination"] = rays.lay_out_volume(
            found.ends, blocks.ids, counts, shape
        )
    if "depth" in signals:
        cells = _find_depth_cells(blocks.ids, counts).clip(0, shape[2] - 1)
        depths = grid.depths(camera, dtype)[cells][:, :, None, None]
        ahead = columns.add_up(jnp.sum(found.ends * depths, axis=1))
        images["depth"] = lay_out(ahead) + behind * jnp.asarray(background_depth, dtype)
    if colors is not None:
        weight = found.reached / jnp.where(density > 1, density, 1)

        def sum_channel(channel):
            cells = fill(scene.mass * channel)
            return columns.add_up(jnp.sum(weight * cells, axis=1))

        ahead = lay_out(jnp.moveaxis(map_channels(sum_channel, colors), 0, -1))
        color = jnp.asarray(background_color, dtype).reshape(1, 1, -1)
        images["color"] = ahead + behind[..., None] * color
    return images, is_right


def _find_depth_cells(ids, counts):
    """Index along a ray of each layer of cells of blocks [M], [M, 8]."""
    first = ids % counts[2] * touched.BLOCK
    return first[:, None] + jnp.arange(touched.BLOCK)[None]
