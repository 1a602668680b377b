"""What every kind of shape can do; `points`, `voxels` and `view_maps` have one each.

An instance holds the shapes of a batch. Its class, which is static, knows what is done
with the scene of one object: a dictionary of what it is rendered from, by name. What a
kind does not say itself, it does as here; what methods are for, and of which types they
take and give, is said here alone.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp

from dpc_jax.config import Render, Train
from dpc_jax.learning.cameras import Cameras, place_camera
from dpc_jax.learning.losses import Term
from dpc_jax.learning.recipe import Recipe
from dpc_jax.learning.schedules import Stage
from dpc_jax.learning.signals import SILHOUETTES, Weights, compare_images, make_targets
from dpc_jax.render import Camera, Projection, VoxelGrid
from dpc_jax.render.batch import map_renders

Scene = Mapping[str, jax.Array]


class View(NamedTuple):
    """From where and how a scene is seen.

    Attributes:
      rotation: [4] object to camera, or [C, 4] of pose candidates.
      camera: of the view. side: of a cubic grid.
      translation: [3] of the object in the camera frame, or None.
      ray_rule: see `project`.
      max_blocks, method: of points of one size, see `project`.
    """

    rotation: jax.Array
    camera: Camera
    side: int
    translation: jax.Array | None = None
    ray_rule: str = "termination"
    max_blocks: int | None = None
    method: str = "trilinear"

    @property
    def without_gradient(self) -> "View":
        """The same view; no gradient reaches it."""
        rotation, camera, translation = jax.lax.stop_gradient(
            (self.rotation, self.camera, self.translation)
        )
        return self._replace(rotation=rotation, camera=camera, translation=translation)

    @property
    def arguments(self) -> dict[str, Any]:
        """As `project` takes them, but for the rotation."""
        return {
            "translation": self.translation,
            "camera": self.camera,
            "grid": VoxelGrid(self.side),
            "ray_rule": self.ray_rule,
        }


def place_view(
    rotation: jax.Array, per_view: Cameras, side: int, render: Render, **how: Any
) -> View:
    """A view of a run; `per_view` is what its camera differs in, `how` other fields."""
    camera = place_camera(Camera(render.focal_length, render.distance), per_view)
    shift = per_view.get("translation")
    return View(rotation, camera, side, shift, render.ray_rule, **how)


class Choice(NamedTuple):
    """How candidates are compared; static.

    Attributes:
      points, top, renders_at_once: as of `hindsight.choose_candidate`.
      weights: of the signals of the comparison at full resolution.
    """

    points: int = 0
    top: int = 0
    renders_at_once: int | None = None
    weights: Weights = SILHOUETTES


class Shape:
    """Shapes of B images."""

    def find_scale(self) -> jax.Array:
        """[B], the figure that is recorded of shapes."""
        raise NotImplementedError

    @classmethod
    def read(
        cls, output: Mapping[str, Any], sigma: jax.Array, *, render: Render
    ) -> Self:
        """All that a network predicts; sigma () of the schedule, of the base grid."""
        raise NotImplementedError

    def drop(self, keys: jax.Array, kept_points: int) -> Self:
        """The shapes with the dropout of training, by the objects' keys [B]."""
        return self

    def list_scenes(self, ratio: float = 1.0) -> tuple[dict[str, Any], dict[str, Any]]:
        """The scenes of a batch: what each has of its own, and what all share.

        Args:
          ratio: of the grid that they are rendered in to the base grid.
        """
        raise NotImplementedError

    def find_places(self) -> tuple[jax.Array, jax.Array | None]:
        """Where the matter is: places [B, n, 3], and weights [B, n] or None."""
        raise NotImplementedError

    def find_cloud(self) -> jax.Array:
        """All points [B, N, 3], where one frame can be found by them for all kinds."""
        raise NotImplementedError

    def find_priors(self, step: jax.Array, *, train: Train) -> dict[str, Term]:
        """Regularisers of the shapes alone. Not in the paper."""
        return {}

    def find_pulls(
        self,
        views: Cameras,
        batch: Mapping[str, jax.Array],
        step: jax.Array,
        *,
        recipe: Recipe,
    ) -> dict[str, Term]:
        """Regularisers of the shapes in their views. Not in the paper."""
        return {}

    def compare(
        self,
        views: Cameras,
        batch: Mapping[str, jax.Array],
        *,
        recipe: Recipe,
        stage: Stage,
    ) -> tuple[jax.Array, dict[str, jax.Array], jax.Array | None]:
        """Eq. 1: differences of each shape's image and its view, averaged over views.

        The sum of a finer image is divided by its pixels per pixel of the base grid, so
        that losses are comparable over the whole run.

        Args:
          views: `Cameras` of the views, and their rotation [B, 4], quaternions.
          batch: masks uint8 [B, S, S], images uint8 [B, S, S, 3] and depths [B, S, S]:
            what the signals that have a weight need.

        Returns:
          (() the weighted sum, which has the gradient; {name: ()} of its terms; [B]
          what each view has of the sum, without gradient).
        """
        render, weights = recipe.render, recipe.weights
        count, ratio = len(views["rotation"]), stage.grid / render.grid
        scene, shared = self.list_scenes(ratio)
        learned = {**scene, **views}
        targets = make_targets(
            batch,
            stage.grid,
            signals=weights.signals,
            distance=render.distance,
            spreads_masks=weights.spreads_masks,
        )
        given: dict[str, Any] = {"targets": targets}
        for name, value in shared.items():
            given[name] = jnp.broadcast_to(jax.lax.stop_gradient(value), count)
        kind, colors_move_shapes = type(self), recipe.train.colors_move_points

        def compare_view(learned, given):
            scene = given | learned
            room = {"max_blocks": stage.max_blocks}
            view = place_view(scene["rotation"], scene, stage.grid, render, **room)
            return kind.compare_view(
                scene,
                view,
                given["targets"],
                weights=weights,
                colors_move_shapes=colors_move_shapes,
            )

        result: Any = sum_views(compare_view, render.renders_at_once, learned, given)
        total, terms, costs = result
        share = 1 / count / ratio**2
        terms = jax.tree.map(lambda value: value * share, terms)
        return total * share, terms, costs / ratio**2

    @staticmethod
    def find_evaluated(output: Mapping[str, Any], scene: Scene) -> dict[str, Any]:
        """What n predicted shapes are evaluated by: fields of `Predictions`.

        Args:
          output: of the network. scene: what each of the n has of its own.
        """
        raise NotImplementedError

    @staticmethod
    def weigh_finest(scene: Scene, render: Render) -> Scene:
        """A scene for the finest grid, as dense as training renders last."""
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
        raise NotImplementedError

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
            colored = cls.render(still, view.without_gradient, signals=("color",))
            image: Any = cls.render(scene, view, signals=others)
            image = dataclasses.replace(image, color=colored.color)
        else:
            image = cls.render(scene, view, signals=signals)
        return compare_images(image, targets, weights=weights, camera=view.camera)

    @classmethod
    def compare_candidates(
        cls,
        scene: Scene,
        view: View,
        targets: Mapping[str, jax.Array],
        how: Choice,
    ) -> jax.Array:
        """Losses [C] of the view's candidates, compared with one target by images.

        Args:
          scene: with sizes in voxels of the target's grid.
          targets: of `make_targets`, as the weights of the signals need them.
        """

        def compute_loss(candidate):
            seen = view._replace(rotation=candidate)
            image = cls.render(scene, seen, signals=how.weights.renders)
            given = {"weights": how.weights, "camera": view.camera}
            return compare_images(image, targets, **given)[0]

        at_once = how.renders_at_once
        return map_renders(compute_loss, view.rotation, renders_at_once=at_once)

    @classmethod
    def rank(
        cls, scene: Scene, view: View, target: jax.Array, how: Choice
    ) -> jax.Array | None:
        """First, coarse losses [C] of the view's candidates by a silhouette [D, D].

        None where the exact ones come first.
        """
        raise NotImplementedError


@functools.partial(jax.custom_vjp, nondiff_argnums=(0, 1))
def sum_views(
    compare: Callable, renders_at_once: int | None, learned: dict[str, Any], given: Any
) -> Any:
    """Σ of what `compare(learned, given)` gives of views, (cost, terms), and costs.

    The gradient is that of the summed costs. A view's is computed right after its
    render, while the volume is in the processor's cache: so no volume is kept for a
    backward pass over the batch.
    """
    return _sum_views_forward(compare, renders_at_once, learned, given)[0]


def _sum_views_forward(compare, renders_at_once, learned, given):
    call = jax.value_and_grad(compare, has_aux=True)
    (costs, terms), gradient = map_renders(
        lambda view: call(*view), (learned, given), renders_at_once=renders_at_once
    )
    return (jnp.sum(costs), jax.tree.map(jnp.sum, terms), costs), gradient


def _sum_views_backward(compare, renders_at_once, gradient, cotangent):
    del compare, renders_at_once
    return jax.tree.map(lambda part: cotangent[0] * part, gradient), None


sum_views.defvjp(_sum_views_forward, _sum_views_backward)


def find_shape_class(name: str) -> type[Shape]:
    """The kind of `network.shape`; only a run that asks for it loads it."""
    if name == "voxels":
        from dpc_jax.learning.shapes.voxels import Voxels

        return Voxels
    if name == "maps":
        from dpc_jax.learning.shapes.view_maps import ViewMaps

        return ViewMaps
    from dpc_jax.learning.shapes.points import Points

    return Points
