"""One object's cloud from its silhouettes alone, without a network.

The projection and the losses of training, with a point cloud and a pose for each view
as what is learned. Given poses need the cloud alone; `pose_search` finds others first,
near rough ones or from nothing.
"""

import dataclasses
import math
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.learning.cameras import place_camera
from dpc_jax.learning.fitting import LEARNED
from dpc_jax.learning.fitting import FitSettings as FitSettings
from dpc_jax.learning.fitting.cloud import METHOD, Cloud, make_shell, split_points
from dpc_jax.learning.fitting.descent import COARSE_UP_TO, Stage, descend
from dpc_jax.learning.fitting.pose_search import SEARCHED_SIDE, search_poses
from dpc_jax.learning.signals import Weights, make_targets
from dpc_jax.render import (
    Camera,
    VoxelGrid,
    arguments,
    checks,
    project_batch,
    quaternion,
)

_COARSEST = 64  # side of the first images; larger ones are halved down to it
_FINEST = 512  # of the last; finer ones have not been tried


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
        `project` takes them with the method "quadratic".
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
      learn: what of the cameras is learned: "rotations" (from nothing where there are
        none, otherwise within about 30 degrees), "translations", "focal_lengths"; the
        means of the last two stay as given.
      depths: [V, S, S], metric z, 0 where not measured.
      colors: [V, S, S, 3] on white, bytes or floats in [0, 1].
      camera: of all views.
      settings: sizes, steps, weights.
      seed: of the first cloud and the searches.
      on_progress: called with what is done, a count and a total.

    Returns:
      `Fit`: the points and their sizes, poses, silhouettes and overlaps of the views.

    Raises:
      ValueError: for a wrong shape or range, an empty silhouette, settings that do
        not fit the images, or a fit that diverges.

    Example:
      >>> disc = np.hypot(*np.mgrid[-7.5:8, -7.5:8]) < 6
      >>> few = dpc_jax.FitSettings(num_points=50, sides=(16,), steps=(3,))
      >>> views, poses = np.stack([disc] * 2) * 1.0, np.tile([1.0, 0, 0, 0], (2, 1))
      >>> dpc_jax.fit(views, rotations=poses, settings=few).points.shape
      (50, 3)
    """
    begin, tell = time.perf_counter(), on_progress or (lambda *_: None)
    views = _check_views(silhouettes, depths, colors)
    settings = _complete_settings(settings, views["masks"])
    is_searched = rotations is None or "rotations" in learn
    _check_settings(settings, views["masks"], learn, is_searched=is_searched)
    arguments.check_view(camera)
    key = jax.random.key(seed)
    how = {"settings": settings, "camera": camera, "tell": tell}
    rotations, translations = _find_poses(views, rotations, learn, key, **how)
    weights = _choose_weights(settings, views)
    cloud = _begin(rotations, translations, key, settings, learn, weights)
    curve: list[dict[str, float]] = []
    for number, side in enumerate(sides := settings.sides):
        done, total = sum(settings.steps[:number]), sum(settings.steps)

        def report(steps, loss, side=side, done=done, total=total):
            step, seconds = steps + done, time.perf_counter() - begin
            record = {"step": step, "seconds": seconds, "side": side, "loss": loss}
            curve.append(record)
            tell(f"fitting at {side}", step, total)

        targets = make_targets(
            views, side, signals=weights.signals, distance=float(camera.distance)
        )
        stage = Stage(settings, number, weights)
        if number and side > COARSE_UP_TO:
            key, own = jax.random.split(key)
            ratio, last = side // sides[number - 1], sides[number - 1]
            cloud = split_points(cloud, own, parts=ratio**2, distance=0.5 / last)
        cloud = descend(cloud, targets, camera, stage, on_progress=report)
    return _finish(cloud, targets["silhouette"], settings, camera, curve)


def _complete_settings(settings: FitSettings, masks) -> FitSettings:
    """With the sides of the images where none are given."""
    sides = settings.sides or list_sides(masks.shape[-1])
    steps = settings.steps[: len(sides)]
    return dataclasses.replace(settings, sides=sides, steps=steps)


def _choose_weights(settings: FitSettings, views) -> Weights:
    """0 for what the views do not show."""
    return Weights(
        1.0,
        settings.depth_weight if "depths" in views else 0.0,
        settings.color_weight if "images" in views else 0.0,
    )


def list_sides(finest: int) -> tuple[int, ...]:
    """Sides of images and volume, coarse to fine, of images with that side."""
    sides = [min(finest, _FINEST)]
    while len(sides) < 2 or sides[0] >= 2 * _COARSEST:
        sides.insert(0, sides[0] // 2)
    return tuple(sides)


def _check_views(silhouettes, depths, colors) -> dict[str, np.ndarray]:
    """Masks uint8 [V, S, S] and what else there is, as `make_targets` reads views."""
    masks = np.asarray(silhouettes)
    side = masks.shape[-1] if masks.ndim else 0
    if masks.ndim != 3 or masks.shape[1] != side or not masks.size:
        raise ValueError(
            "silhouettes must be square images [V, S, S], but their shape is "
            f"{list(masks.shape)}; stack one image for each view."
        )
    views = {"masks": _to_bytes("silhouettes", masks)}
    empty = np.flatnonzero(views["masks"].reshape(len(masks), -1).max(axis=1) < 128)
    if len(empty):
        raise ValueError(
            "silhouettes must show the object in every view, but no pixel of view "
            f"{empty[0]} is covered by half or more; leave such views out."
        )
    if depths is not None:
        depths = checks.check_real("depths", depths, masks.shape)
        views["depths"] = depths = np.asarray(depths, np.float32)
        if not (np.isfinite(depths) & (depths >= 0)).all():
            raise ValueError(
                "depths must be finite and at least 0 (0: not measured), but some are "
                "not; replace those by 0."
            )
    if colors is not None:
        colors = np.asarray(colors)
        if colors.shape != (*masks.shape, 3):
            raise ValueError(
                f"colors must be RGB images {[*masks.shape, 3]} like the silhouettes, "
                f"but their shape is {list(colors.shape)}; give one image of three "
                "channels for each view."
            )
        views["images"] = _to_bytes("colors", colors)
    return views


def _to_bytes(name, values) -> np.ndarray:
    if values.dtype == np.uint8:
        return values
    values = values.astype(np.float32)
    if not ((values >= 0) & (values <= 1)).all():  # NaN is neither
        raise ValueError(
            f"{name} must lie between 0 and 1, or be bytes of 0 to 255, but they reach "
            f"from {values.min():.3g} to {values.max():.3g}; divide them by their "
            "largest value."
        )
    return np.round(255 * values).astype(np.uint8)


def _check_settings(settings: FitSettings, masks, learn, *, is_searched):
    side = masks.shape[-1]
    for name in learn:
        checks.check_choice("learn", name, LEARNED, "name what of the cameras to learn")
    if len(settings.sides) != len(settings.steps):
        raise ValueError(
            "settings.steps must have a number for each of settings.sides, but there "
            f"are {len(settings.steps)} for {len(settings.sides)}; give as many."
        )
    needed = {*settings.sides, *((SEARCHED_SIDE,) if is_searched else ())}
    if any(side % other for other in needed):
        raise ValueError(
            f"silhouettes must have a side that {sorted(needed)} divide, but it is "
            f"{side}; bring the images to {math.lcm(*needed)} or a multiple of it."
        )


def _find_poses(views, rotations, learn, key, **how):
    """Rotations [V, 4] as given or found; translations [V, 3] where learned."""
    count = len(views["masks"])
    translations = jnp.zeros((count, 3)) if "translations" in learn else None
    if rotations is not None:
        rotations = np.asarray(checks.check_array("rotations", rotations, (count, 4)))
        checks.check_values({"rotations": rotations})
        if "rotations" not in learn:
            return rotations, translations
    found = search_poses(views, key, rough=rotations, translations=translations, **how)
    return found.rotations, found.translations


def _begin(rotations, translations, key, settings, learn, weights: Weights) -> Cloud:
    count = settings.num_points
    return Cloud(
        make_shell(key, count),
        jnp.zeros(()),
        jnp.zeros((count, 3)) if weights.color else None,
        jax.vmap(quaternion.normalize)(jnp.asarray(rotations, jnp.float32)),
        translations,
        jnp.zeros(len(rotations)) if "focal_lengths" in learn else None,
    )


def _finish(cloud: Cloud, silhouettes, settings, camera, curve) -> Fit:
    """Render what was found beside what was given."""
    side, sigma = settings.sides[-1], settings.sigma[1]
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(cloud)):
        raise ValueError(
            "Expected a fit that converges, but it has left the range of float32; give "
            f"a smaller learning_rate than {settings.learning_rate}."
        )
    views = cloud.list_views(camera)
    image: Any = project_batch(
        cloud.points,
        cloud.rotations,
        sigma=sigma,
        scale=cloud.find_mass(side),
        translations=cloud.translations,
        camera=place_camera(camera, views),
        grid=VoxelGrid(side),
        method=METHOD,
        # Of coarse images the whole volume, whose program costs less.
        max_blocks=side**3 if side <= COARSE_UP_TO else None,
    ).silhouette
    rendered = np.asarray(image)
    true, found = np.asarray(silhouettes) >= 0.5, rendered >= 0.5

    def read(array):
        return None if array is None else np.asarray(array)

    return Fit(
        points=np.asarray(cloud.points),
        colors=read(cloud.colors),
        rotations=np.asarray(cloud.rotations),
        translations=read(cloud.translations),
        focal_lengths=read(views.get("focal_length")),
        scale=float(cloud.find_mass(side)),
        sigma=sigma,
        side=side,
        silhouettes=rendered,
        overlaps=(found & true).sum((1, 2)) / (found | true).sum((1, 2)),
        curve=curve,
    )
