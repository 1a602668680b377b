"""What every kind of shape can do; `points`, `voxels` and `view_maps` have one each.

An instance holds the shapes of a batch. Its class, which is static, knows what is done
with the scene of one object: a dictionary of what it is rendered from, by name. What a
kind does not say itself, it does as here.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import jax

from dpc_jax.config import Render, Train
from dpc_jax.learning.cameras import Cameras
from dpc_jax.learning.recipe import Recipe, Term
from dpc_jax.learning.schedules import Stage
from dpc_jax.learning.signals import SILHOUETTES, Weights, compare_images
from dpc_jax.render import Camera, Projection, VoxelGrid

Scene = Mapping[str, jax.Array]


class View(NamedTuple):
    """From where and how a scene is seen.

    Attributes:
      rotation: [4] object to camera.
      camera: of the view. side: of a cubic grid.
      translation: [3] of the object in the camera frame, or None.
      ray_rule: see `project`.
    """

    rotation: jax.Array
    camera: Camera
    side: int
    translation: jax.Array | None = None
    ray_rule: str = "termination"

    @property
    def held(self) -> "View":
        """The view without gradient."""
        stop = jax.lax.stop_gradient
        camera = self.camera
        if isinstance(camera.focal_length, jax.Array):  # a view's own
            own = stop(camera.focal_length)
            camera = dataclasses.replace(camera, focal_length=own)
        return View(
            stop(self.rotation),
            camera,
            self.side,
            stop(self.translation),
            self.ray_rule,
        )

    @property
    def arguments(self) -> dict[str, Any]:
        """As `project` takes them, but for the rotation."""
        return {
            "translation": self.translation,
            "camera": self.camera,
            "grid": VoxelGrid(self.side),
            "ray_rule": self.ray_rule,
        }


class Choice(NamedTuple):
    """How candidates are compared; static.

    Attributes:
      points, top, renders_at_once: as of `hindsight.choose_candidate`.
      weights, ray_rule: of the comparison at full resolution.
    """

    points: int
    top: int
    renders_at_once: int
    weights: Weights = SILHOUETTES
    ray_rule: str = "termination"


class Shape:
    """Shapes of B objects."""

    def find_scale(self) -> jax.Array:
        """[B], the figure that is recorded of shapes."""
        raise TypeError("a kind has its own")

    @classmethod
    def read(
        cls, output: Mapping[str, Any], sigma: jax.Array, *, render: Render
    ) -> Self:
        """All that a network predicts; sigma () of the schedule, of the base grid."""
        raise TypeError("a kind has its own")

    def drop(self, keys: jax.Array, kept_points: int) -> Self:
        """The shapes with the dropout of training, by the objects' keys [B]."""
        del keys, kept_points
        return self

    def list_scenes(self, ratio: float = 1.0) -> tuple[dict[str, Any], dict[str, Any]]:
        """The scenes of a batch: what each has of its own, and what all share.

        Args:
          ratio: of the grid that they are rendered in to the base grid.
        """
        raise TypeError("a kind has its own")

    def find_places(self) -> tuple[jax.Array, jax.Array | None]:
        """Where the matter is: places [B, n, 3], and weights [B, n] or None."""
        raise TypeError("a kind has its own")

    def find_cloud(self) -> jax.Array | None:
        """All points [B, N, 3], where one frame can be found by them for all kinds."""

    def find_priors(self, step: jax.Array, *, train: Train) -> dict[str, Term]:
        """Regularisers of the shapes alone. Not in the paper."""
        del step, train
        return {}

    def find_pulls(
        self,
        rotations: jax.Array,
        batch: Mapping[str, jax.Array],
        cameras: Cameras,
        step: jax.Array,
        *,
        recipe: Recipe,
    ) -> dict[str, Term]:
        """Regularisers of the shapes in their views. Not in the paper."""
        del rotations, batch, cameras, step, recipe
        return {}

    def compare(
        self,
        rotations: jax.Array,
        batch: Mapping[str, jax.Array],
        cameras: Cameras,
        *,
        recipe: Recipe,
        stage: Stage,
    ) -> tuple[jax.Array, dict[str, jax.Array], jax.Array | None]:
        """Eq. 1 of all views from their poses; see `winners.compare_winners`."""
        from dpc_jax.learning.choice.winners import compare_winners

        return compare_winners(
            self, rotations, batch, recipe=recipe, stage=stage, cameras=cameras
        )

    @staticmethod
    def find_evaluated(output: Mapping[str, Any], scene: Scene) -> dict[str, Any]:
        """What n predicted shapes are evaluated by: fields of `Predictions`.

        Args:
          output: of the network. scene: what each of the n has of its own.
        """
        raise TypeError("a kind has its own")

    @staticmethod
    def resize(scene: Scene, ratio: float) -> Scene:
        """A scene for a grid with `ratio` times as many cells per side."""
        del ratio
        return scene

    @staticmethod
    def weigh_as_trained(scene: Scene, render: Render) -> Scene:
        """A scene as dense as training renders last."""
        del render
        return scene

    @classmethod
    def render(
        cls,
        scene: Scene,
        view: View,
        *,
        signals: tuple[str, ...],
        background_depth: jax.Array | float = 10.0,
    ) -> Projection:
        """The images of a scene; see `project`."""
        raise TypeError("a kind has its own")

    @classmethod
    def compare_view(
        cls,
        scene: Scene,
        view: View,
        targets: Mapping[str, jax.Array],
        *,
        weights: Weights,
        colors_move_shapes: bool = True,
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """A term of Eq. 1: the weighted sum of a view's losses, and each of them.

        Args:
          targets: of `make_targets`.
          colors_move_shapes: whether colours have a gradient to more than themselves.
        """
        signals = weights.renders
        if "color" in signals and not colors_move_shapes:
            # A pixel of a wrong colour would else be made white by moving its points
            # off. The second render has the values of the first: one is computed.
            others = tuple(signal for signal in signals if signal != "color")
            still = jax.lax.stop_gradient(dict(scene)) | {"colors": scene["colors"]}
            colored = cls.render(still, view.held, signals=("color",))
            image: Any = cls.render(scene, view, signals=others)
            image = dataclasses.replace(image, color=colored.color)
        else:
            image = cls.render(scene, view, signals=signals)
        return compare_images(image, targets, weights=weights, camera=view.camera)

    @staticmethod
    def place_in_image(
        scene: Scene, candidates: jax.Array, view: View, how: Choice
    ) -> Any:
        """What a batch finds of all views at once, for `rank`; None for nothing."""
        del scene, candidates, view, how

    @classmethod
    def rank(
        cls,
        scene: Scene,
        candidates: jax.Array,
        target: jax.Array,
        places: Any,
        *,
        how: Choice,
        **view: Any,
    ) -> jax.Array | None:
        """First, coarse losses [C] of candidates; None where the exact ones come first.

        Args:
          places: of `place_in_image`. view: as of `compute_candidate_losses`.
        """
        raise TypeError("a kind has its own")


def find_kind(name: str) -> type[Shape]:
    """The kind of `network.shape`; only a run that asks for it loads it."""
    if name == "voxels":
        from dpc_jax.learning.shapes.voxels import Voxels

        return Voxels
    if name == "maps":
        from dpc_jax.learning.shapes.view_maps import ViewMaps

        return ViewMaps
    from dpc_jax.learning.shapes.points import Points

    return Points
