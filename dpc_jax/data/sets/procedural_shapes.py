"""Procedural shapes as a source: any number of models, nothing to download."""

import trimesh

from dpc_jax.data.rendering import RenderedSource
from dpc_jax.data.sources import Model, list_procedural
from dpc_jax.shapes import procedural


class ProceduralShapes(RenderedSource):
    """Shapes of a category; no two splits or seeds share one."""

    def list_models(self) -> list[Model]:
        return list_procedural(self.spec, self.spec.models or 0)

    def make_mesh(self, model: Model) -> trimesh.Trimesh:
        return procedural.make_shape(self.spec.category, model.seed)
