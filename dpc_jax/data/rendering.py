"""From a mesh to the arrays of a model: random viewpoints, lights, ground truth."""

import abc

import numpy as np
import trimesh

from dpc_jax.data import surfaces, viewpoints, views
from dpc_jax.data.sources import Model, Source
from dpc_jax.data.splits import SPLITS

CAMERA = ("image_size", "focal_length", "distance", "extent", "supersample")


class RenderedSource(Source):
    """A source whose models are meshes, all rendered in the same way."""

    unit = "mesh"
    work = "Rendering"

    @abc.abstractmethod
    def make_mesh(self, model: Model) -> trimesh.Trimesh:
        """The normalised mesh of a model."""

    def describe_flaws(self, model: Model) -> list[str]:
        """Remarks on what a model lacks, though it can be rendered."""
        return []

    def make_arrays(self, model: Model, index: int) -> tuple[dict, list[str]]:
        arrays = _render_mesh(self.make_mesh(model), self.spec, index)
        empty = int((~arrays["masks"].any(axis=(1, 2))).sum())
        if empty:
            raise ValueError(
                f"Expected the object of {model.path or model.name} in all of its "
                f"{self.spec.views} views, but {empty} are empty; one of its "
                "coordinates may lie far off: repair or remove it."
            )
        return arrays, self.describe_flaws(model)


def _render_mesh(mesh, spec, index):
    """The arrays of a normalised mesh, the index-th of its data set."""
    scene = views.build_scene(mesh)
    points, seen = surfaces.make_marked_truth(mesh, spec, scene=scene)
    camera = {name: getattr(spec, name) for name in CAMERA}
    # every model has its own stream: any number of processes gives the same views
    stream = [spec.seed, SPLITS.index(spec.split), index]
    rng = np.random.default_rng(stream)
    cameras = _draw_cameras(spec, stream)
    pictures = []
    for number in range(spec.views):
        own = {name: rows[number] for name, rows in cameras.items()}
        azimuth = rng.uniform(0.0, 2.0 * np.pi)
        elevation = np.deg2rad(rng.uniform(*spec.elevation))
        rotation = viewpoints.look_at_rotation(azimuth, elevation)
        lights = views.draw_lights(rng)
        view = views.render_view(scene, rotation, lights=lights, **(camera | own))
        pictures.append((*view, rotation))
    corners = _render_corners(scene, camera) if spec.corner_views else {}
    kept = {f"{name}s": rows.astype(np.float32) for name, rows in cameras.items()}
    truth = {"surfaces": points} | ({} if seen is None else {"seen": seen})
    return viewpoints.stack_views(pictures) | truth | kept | corners


def _render_corners(scene, camera):
    """Masks and depths from the corners of a cube, as EPCG learns from."""
    lights = views.Lights(np.zeros((0, 3)), np.zeros(0), 1.0)  # colours are not kept
    seen = [
        views.render_view(
            scene,
            viewpoints.look_at_rotation(*np.deg2rad(angles)),
            lights=lights,
            **camera,
        )
        for angles in viewpoints.CORNERS
    ]
    return {
        "corner_masks": np.stack([view.mask for view in seen]),
        "corner_depths": np.stack([view.depth for view in seen]).astype(np.float32),
    }


def _draw_cameras(spec, stream):
    """Translation and focal length of each view, where views differ in them.

    Of a stream of their own: the same objects are seen from the same sides as without.
    """
    rng = np.random.default_rng([*stream, 1])
    cameras = {}
    if spec.offset:
        low, high = -spec.offset, spec.offset
        cameras["translation"] = rng.uniform(low, high, (spec.views, 3))
    if spec.focal_spread:
        shares = rng.uniform(-spec.focal_spread, spec.focal_spread, spec.views)
        cameras["focal_length"] = spec.focal_length * (1 + shares)
    return cameras
