"""A cloud and the cameras of its views, learned by gradient descent."""

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from dpc_jax.learning.cameras import place_camera
from dpc_jax.learning.losses import repulsion_energy
from dpc_jax.learning.signals import Weights, compare_images
from dpc_jax.learning.silhouette_pull import pull_inside
from dpc_jax.render import Camera, Projection, VoxelGrid, project
from dpc_jax.render.batch import map_renders
from dpc_jax.render.devices import AUTOMATIC

BASE_SIDE = 32  # of the grid that masses are in; a finer one has them in its own voxels
_POINTS = 2000  # that a mass of one voxel each is right for
_REPELLED = 600  # points that repel each other in a step
_COLOR_SHARE = 5.0  # rate of colours' logits, which have several units to go
_POSES = ("rotations", "translations", "log_focal")


class Cloud(NamedTuple):
    """What is fitted; None where it is not there.

    Attributes:
      points: [N, 3] object frame.
      log_mass: (), of all points together, in 2000 voxels of the base grid.
      color_logits: [N, 3], of colours in [0, 1].
      rotations: [V, 4] quaternions of unit length.
      translations: [V, 3], object to camera.
      log_focal: [V], of the focal lengths over the camera's.
    """

    points: jax.Array
    log_mass: jax.Array
    color_logits: jax.Array | None
    rotations: jax.Array
    translations: jax.Array | None
    log_focal: jax.Array | None

    @property
    def colors(self) -> jax.Array | None:
        """[N, 3] in [0, 1]."""
        return None if self.color_logits is None else jax.nn.sigmoid(self.color_logits)

    def find_mass(self, side: int) -> jax.Array:
        """() of each point, in voxels of a grid of that side."""
        share = _POINTS / self.points.shape[0] * (side / BASE_SIDE) ** 3
        return jnp.exp(self.log_mass) * share


def make_shell(key: jax.Array, count: int, radius: float = 0.45) -> jax.Array:
    """Points [count, 3], uniform on a sphere about the origin.

    From outside, points sink until silhouettes hold them up: they end on the surface.
    """
    away = jax.random.normal(key, (count, 3))
    return radius * away / jnp.linalg.norm(away, axis=1, keepdims=True)


def render_view(
    cloud: Cloud,
    view: Mapping[str, jax.Array],
    *,
    sigma: jax.Array | float,
    side: int,
    signals: tuple[str, ...],
    camera: Camera,
) -> Projection:
    """One view: its rotation, and its translation and focal length where it has any."""
    return project(
        cloud.points,
        view["rotation"],
        sigma=sigma,
        scale=cloud.find_mass(side),
        colors=cloud.colors if "color" in signals else None,
        translation=view.get("translation"),
        camera=place_camera(camera, view),
        grid=VoxelGrid(side),
        signals=signals,
    )


def list_views(cloud: Cloud, camera: Camera) -> dict[str, Any]:
    """What each view has of its own, by name, [V, ...]."""
    views: dict[str, Any] = {"rotation": cloud.rotations}
    if cloud.translations is not None:
        views["translation"] = cloud.translations
    if cloud.log_focal is not None:
        views["focal_length"] = camera.focal_length * jnp.exp(cloud.log_focal)
    return views


def compare_views(
    cloud: Cloud,
    targets: Mapping[str, jax.Array],
    *,
    sigma: jax.Array,
    weights: Weights,
    camera: Camera,
) -> jax.Array:
    """The loss of each view [V], per pixel of the targets (Eq. 1)."""
    side = targets["silhouette"].shape[-1]

    def compare(view):
        own, images = view
        image = render_view(
            cloud, own, sigma=sigma, side=side, signals=weights.renders, camera=camera
        )
        return compare_images(image, images, weights=weights, camera=camera)[0]

    losses = map_renders(
        compare, (list_views(cloud, camera), dict(targets)), renders_at_once=AUTOMATIC
    )
    return losses / side**2


@functools.partial(jax.jit, static_argnames="side")
def render_all(
    cloud: Cloud, *, sigma: jax.Array | float, side: int, camera: Camera
) -> jax.Array:
    """Silhouettes of all views [V, side, side]."""
    names = ("silhouette",)

    def render(view):
        return render_view(
            cloud, view, sigma=sigma, side=side, signals=names, camera=camera
        ).silhouette

    return map_renders(render, list_views(cloud, camera), renders_at_once=AUTOMATIC)


def find_losses(
    cloud: Cloud,
    candidates: jax.Array,
    silhouettes: jax.Array,
    *,
    sigma: jax.Array,
    camera: Camera,
) -> jax.Array:
    """Loss per pixel of every candidate in every view [V, K], without gradient.

    Args:
      candidates: [K, 4] quaternions, the same for all views. silhouettes: [V, D, D].
    """
    side = silhouettes.shape[-1]
    cloud = jax.lax.stop_gradient(cloud)

    def compare(candidate):
        image = render_view(
            cloud,
            {"rotation": candidate},
            sigma=sigma,
            side=side,
            signals=("silhouette",),
            camera=camera,
        ).silhouette
        assert image is not None
        return jnp.mean((image[None] - silhouettes) ** 2, axis=(1, 2))

    return map_renders(compare, candidates, renders_at_once=AUTOMATIC).T


def pull(cloud: Cloud, outside: jax.Array, *, camera: Camera) -> jax.Array:
    """`pull_inside` of all views in the mean; (). Outside is [V, D, D]."""

    def measure(view):
        own, distances = view
        return pull_inside(
            cloud.points,
            own["rotation"],
            distances,
            camera=place_camera(camera, own),
            translation=own.get("translation"),
        )

    return jnp.mean(jax.vmap(measure)((list_views(cloud, camera), outside)))


def repel(cloud: Cloud, key: jax.Array) -> jax.Array:
    """`repulsion_energy` of some of the points; ()."""
    count = cloud.points.shape[0]
    some = jax.random.choice(key, count, (min(count, _REPELLED),), replace=False)
    return repulsion_energy(cloud.points[some])


def make_optimizer(
    *,
    rate: optax.Schedule,
    camera_rate: optax.Schedule,
    learned: tuple[str, ...],
) -> optax.GradientTransformation:
    """Adam of the cloud, and of those cameras' parts that are learned.

    Args:
      rate, camera_rate: learning rates over steps. learned: names of `Cloud` among
        those of cameras.
    """

    def label(path, _):
        field = path[0].name
        if field == "color_logits":
            return "colors"
        if field not in _POSES:
            return "cloud"
        return "camera" if field in learned else "given"

    return optax.multi_transform(
        {
            "cloud": optax.adam(rate),
            "colors": optax.adam(lambda step: _COLOR_SHARE * rate(step)),
            "camera": optax.adam(camera_rate),
            "given": optax.set_to_zero(),
        },
        lambda cloud: jax.tree_util.tree_map_with_path(label, cloud),
    )
