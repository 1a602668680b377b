"""Renders of a scene: a predicted shape, seen from the candidates of a view.

A scene has what one object is rendered from, by name: points [N, 3], their mass and
sigma (`point_sizes`), or points and their point_logits [N] (`view_maps`), or cells
[D, D, D] of a voxel model; and its colors, [N, 3] or [D, D, D, 3], where they are
compared. A batch has one axis more.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from dpc_jax.config import Render
from dpc_jax.learning.point_sizes import (
    has_own_sizes,
    scale_point_sizes,
    split_size,
)
from dpc_jax.learning.predictions import Cells, Maps, Shapes, find_sizes
from dpc_jax.learning.signals import SILHOUETTES, Weights, compare_images
from dpc_jax.render import Camera, Projection, VoxelGrid, project, project_volume
from dpc_jax.render.batch import map_renders
from dpc_jax.render.devices import AUTOMATIC

Scene = Mapping[str, jax.Array]


def make_scenes(
    shapes: Shapes | Cells | Maps, ratio: float = 1.0
) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
    """The scenes of a batch: what each has of its own, and what all share.

    Args:
      shapes: of B objects. ratio: of the grid that they are rendered in to the base
        grid, in whose voxels the sizes of points are.
    """
    colors = {} if shapes.colors is None else {"colors": shapes.colors}
    if isinstance(shapes, Cells):
        return {"cells": shapes.cells} | colors, {}
    if isinstance(shapes, Maps):
        return {"points": shapes.points, "point_logits": shapes.logits}, {}
    sigma, mass = scale_point_sizes(shapes.sigma, shapes.mass, ratio)
    scene = {"points": shapes.kept, "mass": mass} | colors
    if has_own_sizes(sigma):
        return scene | {"sigma": sigma}, {}
    return scene, {"sigma": sigma}


def find_scenes(
    output: Mapping[str, jax.Array], sigma: jax.Array, *, render: Render
) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
    """`make_scenes` of all that a network predicts, without point dropout.

    Args:
      output: of the network. sigma: () of the schedule, in voxels of the base grid.
    """
    colors = output.get("colors")
    if "cells" in output:
        return make_scenes(Cells(output["cells"], colors))
    if "maps" in output:
        maps, points = output["maps"], output["points"]
        return make_scenes(Maps(maps, points, output["point_logits"]))
    points, scale = output["points"], output["scale"]
    size, mass = find_sizes(
        output, sigma, scale_unit=render.scale_unit, grid=render.grid
    )
    return make_scenes(Shapes(points, points, colors, scale, mass, size))


def resize_scene(scene: Scene, ratio: float) -> Scene:
    """A scene for a grid with `ratio` times as many cells per side."""
    if "sigma" not in scene:  # nothing of it is in cells of the grid
        return scene
    sigma, mass = scale_point_sizes(scene["sigma"], scene["mass"], ratio)
    return {**scene, "sigma": sigma, "mass": mass}


def weigh_as_trained(scene: Scene, render: Render) -> Scene:
    """A scene whose points have together the mass that training renders last.

    Their masses were learned where dropout leaves a share of them out: with
    `render.keep_end` below 1, outlines of all of them would be wider than the images'.
    """
    if "mass" not in scene:
        return scene
    return {**scene, "mass": render.keep_end * scene["mass"]}


def render_scene(
    scene: Scene,
    rotation: jax.Array,
    *,
    translation: jax.Array | None,
    camera: Camera,
    side: int,
    signals: tuple[str, ...],
    ray_rule: str = "termination",
    background_depth: jax.Array | float = 10.0,
) -> Projection:
    """The images of a scene in a cubic grid of that side; see `project`."""
    view = {
        "translation": translation,
        "camera": camera,
        "grid": VoxelGrid(side),
        "signals": signals,
        "ray_rule": ray_rule,
        "background_depth": background_depth,
        "colors": scene["colors"] if "color" in signals else None,
    }
    if "cells" in scene:
        return project_volume(scene["cells"], rotation, **view)
    if "point_logits" in scene:
        from dpc_jax.learning import view_maps  # of a baseline alone

        drawn = view_maps.pseudo_render(
            scene["points"],
            scene["point_logits"],
            rotation,
            camera=camera,
            side=side,
            translation=translation,
        )
        return view_maps.show_render(drawn, background=background_depth)
    sigma, covariance = split_size(jnp.asarray(scene["sigma"]))
    sizes = {"sigma": sigma, "covariance": covariance, "scale": scene["mass"]}
    return project(scene["points"], rotation, **sizes, **view)


def compute_candidate_losses(
    scene: Scene,
    candidates: jax.Array,
    target: jax.Array,
    *,
    camera: Camera,
    renders_at_once: int = AUTOMATIC,
    translation: jax.Array | None = None,
    others: Mapping[str, jax.Array] | None = None,
    weights: Weights = SILHOUETTES,
    ray_rule: str = "termination",
) -> jax.Array:
    """Loss of each pose candidate of one view, by its silhouette or by more signals.

    Args:
      scene: with sizes in voxels of the target's grid.
      candidates: [C, 4] quaternions.
      target: [D, D] silhouette.
      camera, ray_rule: see `project`.
      renders_at_once: how many candidates are rendered side by side, see `map_renders`.
      translation: [3] of the object in the camera frame.
      others: targets of other signals by name (`make_targets`), as the weights need
        them.
      weights: of the signals.

    Returns:
      [C].
    """
    targets = {"silhouette": target, **(others or {})}

    def compute_loss(candidate):
        image = render_scene(
            scene,
            candidate,
            translation=translation,
            camera=camera,
            side=target.shape[0],
            signals=weights.renders,
            ray_rule=ray_rule,
        )
        return compare_images(image, targets, weights=weights, camera=camera)[0]

    return map_renders(compute_loss, candidates, renders_at_once=renders_at_once)
