"""From a mesh to the arrays of a model: random viewpoints, lights, ground truth."""

import numpy as np
import trimesh

from dpc_jax.data import surfaces, viewpoints, views
from dpc_jax.data.sources import Model, Source, view_arrays
from dpc_jax.data.splits import SPLITS


class RenderedSource(Source):
    """A source whose models are meshes, all rendered in the same way."""

    unit = "mesh"

    def make_mesh(self, model: Model) -> trimesh.Trimesh:
        """The normalised mesh of a model."""
        raise NotImplementedError

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
    arrays = view_arrays(spec.views, spec.image_size)
    # every model has its own stream: any number of processes gives the same views
    rng = np.random.default_rng([spec.seed, SPLITS.index(spec.split), index])
    for view in range(spec.views):
        azimuth = rng.uniform(0.0, 2.0 * np.pi)
        elevation = np.deg2rad(rng.uniform(*spec.elevation))
        rotation = viewpoints.look_at_rotation(azimuth, elevation)
        picture = views.render_view(
            scene,
            rotation,
            lights=views.draw_lights(rng),
            image_size=spec.image_size,
            focal_length=spec.focal_length,
            distance=spec.distance,
            extent=spec.extent,
            supersample=spec.supersample,
        )
        arrays["images"][view] = picture.image
        arrays["masks"][view] = picture.mask
        arrays["depths"][view] = picture.depth
        arrays["quaternions"][view] = viewpoints.matrix_to_quaternion(rotation)
    return arrays | {"surfaces": points}
