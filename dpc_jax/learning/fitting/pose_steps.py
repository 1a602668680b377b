"""Levenberg-Marquardt steps of the poses of one object's views, the cloud held.

A step goes as far as the images say, and only where it makes them more alike: after few
steps candidates can be compared, however far apart they began.
"""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from dpc_jax.learning.cameras import place_camera
from dpc_jax.learning.fitting.cloud import METHOD, Cloud
from dpc_jax.learning.shapes.kind import View
from dpc_jax.learning.shapes.points import Points
from dpc_jax.render import quaternion
from dpc_jax.render.batch import map_renders

_DAMPING = 1e-4  # of the normal equations, mean squares per squared radian
_FARTHEST = 0.05  # that a step turns and moves an object; radians, box diagonals


def step_poses(cloud: Cloud, silhouettes, *, sigma, camera) -> tuple[Cloud, jax.Array]:
    """One step of every view: the cloud, losses per pixel [V] before it.

    Slopes are differences between images half a voxel to both sides. Translations move
    as well where the cloud has them.

    Args:
      silhouettes: [V, D, D]. sigma: of the points, voxels. camera: of all views.
    """
    side = silhouettes.shape[-1]
    scene = {"points": cloud.points, "mass": cloud.find_mass(side), "sigma": sigma}
    size, apart = (3 if cloud.translations is None else 6), 0.5 / side
    asides = apart * jnp.eye(size)
    differences = jnp.concatenate([jnp.zeros((1, size)), asides, -asides])

    def improve(entry):
        own, silhouette = entry

        def render(step):
            moved = _move(own, step)
            seen, translation = place_camera(camera, moved), moved.get("translation")
            view = View(moved["rotation"], seen, side, translation, method=METHOD)
            image: Any = Points.render(scene, view, signals=("silhouette",)).silhouette
            return image

        images = map_renders(render, differences, renders_at_once=None)
        error = images[0] - silhouette
        slopes = (images[1 : size + 1] - images[size + 1 :]) / (2 * apart)
        normal = jnp.einsum("iyx,jyx->ij", slopes, slopes) / side**2
        slope = jnp.einsum("iyx,yx->i", slopes, error) / side**2
        step = -jnp.linalg.solve(normal + _DAMPING * jnp.eye(size), slope)
        step *= jnp.minimum(1, _FARTHEST / jnp.maximum(jnp.linalg.norm(step), 1e-9))
        tries = jnp.stack([jnp.zeros(size), step, step / 3])
        after = map_renders(render, tries[1:], renders_at_once=None)
        errors = jnp.concatenate([images[:1], after]) - silhouette[None]
        losses = jnp.mean(errors**2, axis=(1, 2))
        return _move(own, tries[jnp.argmin(losses)]), losses[0]

    moved, losses = jax.lax.map(improve, (cloud.list_views(camera), silhouettes))
    found = {"rotations": moved["rotation"], "translations": moved.get("translation")}
    return cloud._replace(**found), losses


def _move(own: Mapping[str, jax.Array], step) -> dict[str, jax.Array]:
    """A view whose object is turned by step [:3], radians, and moved by the rest."""
    turn = quaternion.normalize(jnp.concatenate([jnp.ones(1), step[:3] / 2]))
    moved = {**own, "rotation": quaternion.multiply(turn, own["rotation"])}
    if "translation" in own:
        moved["translation"] = own["translation"] + step[3:]
    return moved
