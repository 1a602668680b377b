"""Volumes of occupancies: the shapes of Ours-V, PTN, DRC and MVC (docs/baselines.md).

A scene has cells [D, D, D], and where they are compared colors [D, D, D, 3].
"""

import dataclasses

import jax
import jax.numpy as jnp

from dpc_jax.learning.shapes.kind import Shape
from dpc_jax.learning.signals import SILHOUETTES, average_blocks
from dpc_jax.render import project_volume

# Of the image in which candidates are first compared: a 64th of the work in 64³.
COARSE_SIDE = 16


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Voxels(Shape):
    """Predicted volumes of B images.

    Attributes:
      cells: [B, D, D, D] occupancies in the object frame, see `project_volume`.
      colors: [B, D, D, D, 3], or None.
    """

    cells: jax.Array
    colors: jax.Array | None

    def find_scale(self):
        """Mean occupancy, which is recorded where points have their scale."""
        return jnp.mean(self.cells, axis=(1, 2, 3))

    @classmethod
    def read(cls, output, sigma, *, render):
        return cls(output["cells"], output.get("colors"))

    def list_scenes(self, ratio=1.0):
        colors = {} if self.colors is None else {"colors": self.colors}
        return {"cells": self.cells} | colors, {}

    def find_places(self):
        sides = self.cells.shape[1:]
        axes = [(jnp.arange(side) + 0.5) / side - 0.5 for side in sides]
        centers = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        weights = self.cells.reshape(len(self.cells), -1)
        return jnp.broadcast_to(centers[None], (*weights.shape, 3)), weights

    @staticmethod
    def find_evaluated(output, scene):
        """Cells; their surface has points once `volumes.add_points` finds them."""
        return {
            "cells": output["cells"],
            "points": jnp.zeros((len(output["cells"]), 0, 3)),
        }

    @classmethod
    def render(cls, scene, view, *, signals, background_depth=10.0):
        return project_volume(
            scene["cells"],
            view.rotation,
            colors=scene["colors"] if "color" in signals else None,
            signals=signals,
            background_depth=background_depth,
            **view.arguments,
        )

    @classmethod
    def rank(cls, scene, view, target, how):
        """Volumes stay as they are, and are seen in a coarser grid."""
        if not how.points or target.shape[0] < 2 * COARSE_SIDE:
            return None
        return cls.compare_candidates(
            scene,
            view._replace(side=COARSE_SIDE),
            {"silhouette": average_blocks(target, COARSE_SIDE)},
            how._replace(weights=SILHOUETTES),
        )
