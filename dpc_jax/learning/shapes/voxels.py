"""Volumes of occupancies: the shapes of Ours-V, PTN, DRC and MVC (docs/baselines.md).

A scene has cells [D, D, D], and where they are compared colors [D, D, D, 3].
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, Self

import jax
import jax.numpy as jnp

from dpc_jax.config import Render
from dpc_jax.learning.shapes.kind import Choice, Scene, Shape, View
from dpc_jax.learning.signals import average_blocks
from dpc_jax.render import Projection, project_volume

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

    def find_scale(self) -> jax.Array:
        """Mean occupancy, which is recorded where points have their scale."""
        return jnp.mean(self.cells, axis=(1, 2, 3))

    @classmethod
    def read(
        cls, output: Mapping[str, Any], sigma: jax.Array, *, render: Render
    ) -> Self:
        return cls(output["cells"], output.get("colors"))

    def list_scenes(self, ratio: float = 1.0) -> tuple[dict[str, Any], dict[str, Any]]:
        colors = {} if self.colors is None else {"colors": self.colors}
        return {"cells": self.cells} | colors, {}

    def find_places(self) -> tuple[jax.Array, jax.Array | None]:
        sides = self.cells.shape[1:]
        axes = [(jnp.arange(side) + 0.5) / side - 0.5 for side in sides]
        centers = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        weights = self.cells.reshape(len(self.cells), -1)
        return jnp.broadcast_to(centers[None], (*weights.shape, 3)), weights

    @staticmethod
    def find_evaluated(output: Mapping[str, Any], scene: Scene) -> dict[str, Any]:
        """Cells; their surface has points once `volumes.add_points` finds them."""
        return {
            "cells": output["cells"],
            "points": jnp.zeros((len(output["cells"]), 0, 3)),
        }

    @classmethod
    def render(
        cls,
        scene: Scene,
        view: View,
        *,
        signals: tuple[str, ...],
        background_depth: jax.Array | float = 10.0,
    ) -> Projection:
        return project_volume(
            scene["cells"],
            view.rotation,
            colors=scene["colors"] if "color" in signals else None,
            signals=signals,
            background_depth=background_depth,
            **view.arguments,
        )

    @classmethod
    def rank(
        cls, scene: Scene, view: View, target: jax.Array, how: Choice
    ) -> jax.Array | None:
        """Volumes stay as they are, and are seen in a coarser grid."""
        if not how.points or target.shape[0] < 2 * COARSE_SIDE:
            return None
        return cls.compare_candidates(
            scene,
            view._replace(side=COARSE_SIDE),
            {"silhouette": average_blocks(target, COARSE_SIDE)},
            renders_at_once=how.renders_at_once,
        )
