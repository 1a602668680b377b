"""One object's cloud from its silhouettes alone, without a network.

The projection and the losses of training, with a point cloud and a pose for each view
as what is learned. Given poses need the cloud alone; rough ones are learned with it; of
none, `pose_search` finds rough ones first.
"""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.learning.fitting import cloud as clouds
from dpc_jax.learning.fitting import pose_search
from dpc_jax.learning.fitting.descent import CHUNK, Stage, advance, make_optimizer
from dpc_jax.learning.fitting.settings import LEARNED, FitSettings
from dpc_jax.learning.fitting.views import (
    Views,
    check_views,
    list_targets,
)
from dpc_jax.learning.signals import Weights
from dpc_jax.learning.silhouette_pull import measure_outside
from dpc_jax.render import Camera, arguments, checks, quaternion

_FINEST = 128  # side, unless settings say another: a fit takes a minute of two cores


@dataclasses.dataclass(frozen=True)
class Fit:
    """A fitted object.

    Attributes:
      points: [N, 3] object frame; that of the given rotations, any other without.
      colors: [N, 3] in [0, 1]; None without colours.
      rotations: [V, 4] quaternions, object to camera.
      translations: [V, 3] in the camera frame; None where not learned.
      focal_lengths: [V]; None where not learned.
      scale, sigma: () mass and size of a point, voxels of a grid of `side`, as
        `project` takes them.
      side: of the finest grid.
      silhouettes: [V, side, side], as rendered in the end.
      overlaps: [V], intersection over union of these with the given ones, at a half.
      curve: a record for every few steps: step, seconds since the call (a search for
        poses counts), side, loss (per pixel, without priors).
    """

    points: np.ndarray
    colors: np.ndarray | None
    rotations: np.ndarray
    translations: np.ndarray | None
    focal_lengths: np.ndarray | None
    scale: float
    sigma: float
    side: int
    silhouettes: np.ndarray
    overlaps: np.ndarray
    curve: list[dict[str, float]]


def fit(
    silhouettes: Any,
    *,
    rotations: Any = None,
    learn: tuple[str, ...] = (),
    depths: Any = None,
    colors: Any = None,
    camera: Camera = Camera(),
    settings: FitSettings = FitSettings(),
    seed: int = 0,
    on_progress: Callable[[str, int, int], None] | None = None,
) -> Fit:
    """Fit a point cloud to the views of one object.

    Args:
      silhouettes: [V, S, S], share of each pixel that the object covers: bytes, or
        floats in [0, 1]. The camera looks at the object's middle, which lies within
        half a unit of the origin.
      rotations: [V, 4] quaternions, object to camera; None to find them. A shape and
        its mirror image cast nearly the same shadows: without rotations, either may be
        found, in any frame.
      learn: what of the cameras is learned, of "rotations" (always where there are
        none), "translations" and "focal_lengths"; their means stay as given.
      depths: [V, S, S], metric z, 0 where not measured.
      colors: [V, S, S, 3] on white, bytes or floats in [0, 1].
      camera: of all views.
      settings: sizes, steps, weights.
      seed: of the first cloud and the searches.
      on_progress: called with what is done, a count and a total.

    Raises:
      ValueError: for a wrong shape or range, an empty silhouette, or settings that do
        not fit the images.
    """
    begin = time.perf_counter()
    views = check_views(silhouettes, depths, colors)
    if not settings.sides:
        finest = min(views.masks.shape[-1], _FINEST)
        settings = dataclasses.replace(settings, sides=(finest // 2, finest))
    _check_settings(settings, views, learn, is_searched=rotations is None)
    arguments.check_camera(camera)
    tell = on_progress or (lambda *_: None)
    if rotations is None:
        learn = tuple(dict.fromkeys(("rotations", *learn)))
        rotations = _search(views, camera, settings, seed, tell)
    else:
        rotations = np.asarray(
            checks.check_array("rotations", rotations, (len(views.masks), 4))
        )
        checks.check_values({"rotations": rotations})
    fitting = _Fitting(views, camera, settings, learn, tell, begin)
    cloud = fitting.start(rotations, jax.random.key(seed))
    for number in range(len(settings.sides)):
        cloud = fitting.run_side(cloud, number)
    return fitting.finish(cloud)


def _check_settings(settings: FitSettings, views: Views, learn, *, is_searched):
    side = views.masks.shape[-1]
    for name in learn:
        checks.check_choice("learn", name, LEARNED, "name what of the cameras to learn")
    if len(settings.sides) != len(settings.steps):
        raise ValueError(
            "settings.steps must have a number for each of settings.sides, but there "
            f"are {len(settings.steps)} for {len(settings.sides)}; give as many."
        )
    if np.shape(settings.camera_share) != (2,):
        raise ValueError(
            "settings.camera_share must be a pair, of the first side and of the finer "
            f"ones, but it is {settings.camera_share!r}; give for example (0.1, 0.6)."
        )
    needed = set(settings.sides)
    if is_searched:
        needed |= {pose_search.COARSE.side, pose_search.FINE.side}
    if any(side % other for other in needed):
        raise ValueError(
            f"silhouettes must have a side that {sorted(needed)} divide, but it is "
            f"{side}; bring the images to {max(settings.sides)} or a multiple of it."
        )


def _search(views, camera, settings, seed, tell) -> np.ndarray:
    def read_silhouettes(side):
        return list_targets(views, side, signals=(), camera=camera)["silhouette"]

    return pose_search.search_poses(
        read_silhouettes,
        jax.random.key(seed),
        searches=settings.searches,
        rounds=settings.rounds,
        elevations=settings.elevations,
        camera=camera,
        tell=tell,
    )


class _Fitting:
    """Gradient descent on one object's views, side after side."""

    def __init__(self, views: Views, camera, settings, learn, tell, begin):
        self.views, self.camera, self.settings = views, camera, settings
        self.learn, self.tell, self.begin = learn, tell, begin
        self.weights = Weights(
            1.0,
            settings.depth_weight if views.depths is not None else 0.0,
            settings.color_weight if views.images is not None else 0.0,
        )
        self.curve: list[dict[str, float]] = []
        self.total = sum(settings.steps)

    def start(self, rotations: np.ndarray, key: jax.Array) -> clouds.Cloud:
        count = len(rotations)
        return clouds.Cloud(
            clouds.make_shell(key, self.settings.num_points),
            jnp.zeros(()),
            jnp.zeros((self.settings.num_points, 3)) if self.weights.color else None,
            jax.vmap(quaternion.normalize)(jnp.asarray(rotations, jnp.float32)),
            jnp.zeros((count, 3)) if "translations" in self.learn else None,
            jnp.zeros(count) if "focal_lengths" in self.learn else None,
        )

    def run_side(self, cloud: clouds.Cloud, number: int) -> clouds.Cloud:
        """All steps of one of the sides."""
        side, steps = self.settings.sides[number], self.settings.steps[number]
        targets = list_targets(
            self.views, side, signals=self.weights.signals, camera=self.camera
        )
        outside = jax.lax.map(measure_outside, targets["silhouette"])
        stage = Stage(
            self.settings,
            number,
            self.weights,
            tuple(name.replace("focal_lengths", "log_focal") for name in self.learn),
        )
        parameters: Any = cloud
        state = make_optimizer(stage).init(parameters)
        done = sum(self.settings.steps[:number])
        for first in range(0, steps, CHUNK):
            cloud, state, loss = advance(
                cloud,
                state,
                jnp.asarray(first),
                targets,
                outside,
                self.camera,
                stage=stage,
            )
            step = min(first + CHUNK, steps) + done
            seconds = time.perf_counter() - self.begin
            record = {"step": step, "seconds": seconds, "side": side}
            self.curve.append(record | {"loss": float(loss)})
            self.tell(f"fitting at {side}", step, self.total)
        return cloud

    def finish(self, cloud: clouds.Cloud) -> Fit:
        """Render what was found beside what was given."""
        side, sigma = self.settings.sides[-1], self.settings.sigma[1]
        rendered = np.asarray(
            clouds.render_all(cloud, sigma=sigma, side=side, camera=self.camera)
        )
        targets = list_targets(self.views, side, signals=(), camera=self.camera)
        true = np.asarray(targets["silhouette"]) >= 0.5
        found = rendered >= 0.5
        overlaps = (found & true).sum((1, 2)) / (found | true).sum((1, 2))
        focal = None
        if cloud.log_focal is not None:
            focal = np.asarray(self.camera.focal_length * jnp.exp(cloud.log_focal))

        def read(array):
            return None if array is None else np.asarray(array)

        return Fit(
            points=np.asarray(cloud.points),
            colors=read(cloud.colors),
            rotations=np.asarray(cloud.rotations),
            translations=read(cloud.translations),
            focal_lengths=focal,
            scale=float(cloud.find_mass(side)),
            sigma=sigma,
            side=side,
            silhouettes=rendered,
            overlaps=overlaps,
            curve=self.curve,
        )
