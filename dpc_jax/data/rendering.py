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

    @abc.abstractmethod
    def make_mesh(self, model: Model) -> trimesh.Trimesh:
        """The normalised mesh of a model."""

    def describe_flaws(self, model: Model) -> list[str]:
        """Remarks on what a model lacks, though it can be rendered."""
        return []

    def make_arrays(self, model: Model, index: int) -> tuple[dict, list[str]]:
        arrays = _render_mesh(self.make_mesh(model), self.spec, index)
        return arrays, self.describe_flaws(model)


def _render_mesh(mesh, spec, index):
    """The arrays of a normalised mesh, the index-th of its data set."""
    scene = views.build_scene(mesh)
    points = surfaces.make_ground_truth(mesh, spec, scene=scene)
    camera = {name: getattr(spec, name) for name in CAMERA}
    # every model has its own stream: any number of processes gives the same views
    rng = np.random.default_rng([spec.seed, SPLITS.index(spec.split), index])
    pictures = []
    for _ in range(spec.views):
        azimuth = rng.uniform(0.0, 2.0 * np.pi)
        elevation = np.deg2rad(rng.uniform(*spec.elevation))
        rotation = viewpoints.look_at_rotation(azimuth, elevation)
        lights = views.draw_lights(rng)
        view = views.render_view(scene, rotation, lights=lights, **camera)
        pictures.append((*view, rotation))
    return viewpoints.stack_views(pictures) | {"surfaces": points}
