"""Procedural shapes as a source: any number of models, nothing to download."""

import trimesh

from dpc_jax.data.rendering import RenderedSource
from dpc_jax.data.sources import Model
from dpc_jax.data.spec import SEEDS_PER_SPLIT
from dpc_jax.data.splits import SPLITS
from dpc_jax.shapes import procedural


class ProceduralShapes(RenderedSource):
    """Shapes of a category; no two splits or seeds share one."""

    def list_models(self) -> list[Model]:
        spec = self.spec
        first = (spec.seed * len(SPLITS) + SPLITS.index(spec.split)) * SEEDS_PER_SPLIT
        return [
            Model(f"{spec.category}-{seed:07d}", None, seed, 0, "", spec.views)
            for seed in range(first, first + (spec.models or 0))
        ]

    def make_mesh(self, model: Model) -> trimesh.Trimesh:
        return procedural.make_shape(self.spec.category, model.seed)
