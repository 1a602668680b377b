"""Predictions for a whole data set."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding

from dpc_jax.config import Config
from dpc_jax.data import DataSet
from dpc_jax.learning import devices, schedules
from dpc_jax.learning.batches import list_extras
from dpc_jax.learning.cameras import find_cameras
from dpc_jax.learning.candidates import Poses, complete_poses, find_probabilities
from dpc_jax.learning.framing import make_inputs
from dpc_jax.learning.inference.explanation import (
    compare_poses,
    find_color_scores,
    observe,
    render_finest,
    weigh_by_colors,
)
from dpc_jax.learning.inference.search import add_viewpoints, find_likeliest
from dpc_jax.learning.shapes import find_shape_class
from dpc_jax.learning.step import TrainState, find_parts
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.networks.encoder import TINT
from dpc_jax.render.batch import map_renders

VIEWS_AT_ONCE = 50  # that are predicted: 20 models of five views in two batches


class Predictions(NamedTuple):
    """What the network says of M models with V views each, in its own frame.

    Attributes:
      points: [M, V, N, 3], the shape predicted from each view; of voxel models none
        until `volumes.add_points`.
      colors: [M, V, N, 3], or None.
      poses: [M, V, 4], predicted: the student's quaternion, or that of the largest
        posterior (`pose.student`), a viewpoint then searched for nearby; the given
        one where poses are known.
      winners: [M, V] index of the candidate, turned or not, that fits the view best; of
        head index % K.
      silhouettes: [M, V, D, D], the shape seen from the predicted pose, its points of
        the size that the schedule ends with.
      depths: [M, V, D, D], color_images: [M, V, D, D, 3] of the same render; None for
        data without depths, and where no colours are learned.
      translations: [M, V, 3], focal_lengths: [M, V] as predicted; None where they are
        not learned.
      sizes: [M, V, N] sigmas in voxels of the base grid, or [M, V, N, 3, 3] covariances
        in voxels², where they are learned; else None.
      cells: [M, V, D, D, D], the occupancies that voxel models predict; else None.
      candidates: [M, V, C, 4], turned ones included; probabilities: [M, V, C] of them
        by student (alike where it does not select) and colours; losses: [M, V, C] of
        them in the base grid. Confidence and refinement need them.
      codes: [M, V, F] that shapes are decoded from, tints at the end.
    """

    points: np.ndarray
    poses: np.ndarray
    winners: np.ndarray
    silhouettes: np.ndarray
    candidates: np.ndarray
    probabilities: np.ndarray
    losses: np.ndarray
    codes: np.ndarray
    colors: np.ndarray | None = None
    depths: np.ndarray | None = None
    color_images: np.ndarray | None = None
    translations: np.ndarray | None = None
    focal_lengths: np.ndarray | None = None
    sizes: np.ndarray | None = None
    cells: np.ndarray | None = None


def make_predictor(
    network: ShapePoseNetwork, config: Config, *, knows_distance: bool = True
) -> Callable:
    """The compiled function (state, images, masks, quaternions, extras) -> dict.

    It runs over the devices. For n views: images uint8 [n, S, S, 3], masks uint8
    [n, S, S], quaternions [n, 4], extras: arrays [n, ...] of `list_extras`, those there
    are. The dictionary has the fields of `Predictions`, with one leading axis [n];
    those that a run does not have are left out.

    Of photographs, whose distance is not known, the network sees what the box of the
    mask frames, if it has learned from such views, and silhouettes are compared each in
    a frame of its own.
    """

    def predict(state, images, masks, quaternions, extras):
        is_framed = not knows_distance and config.train.framed_views
        inputs = make_inputs(images, masks, network=network, is_framed=is_framed)
        with devices.sharing_columns():
            output: Any = network.apply(state.params, inputs, method=_predict_all)
        arrays = {"images": images, "masks": masks, **extras}
        entries, shared = _list_entries(
            output, state, arrays, quaternions, config, knows_distance
        )
        scores = find_color_scores(state.averages.frame, config)
        found = map_renders(
            functools.partial(_explain, shared=shared, scores=scores, config=config),
            entries,
            renders_at_once=config.render.renders_at_once,
        )
        found["candidates"] = entries["poses"].candidates
        kept = ("codes", "translations", "focal_lengths")
        found |= {name: output[name] for name in kept if name in output}
        return found | find_shape_class(config.network.shape).find_evaluated(
            output, entries["scene"]
        )

    mesh = devices.make_mesh(config)
    # Every process of a job gets all of it.
    whole = NamedSharding(mesh, devices.WHOLE) if jax.process_count() > 1 else None
    in_specs = (find_parts(network, config), *[devices.OBJECTS] * 4)
    return jax.jit(devices.share_padded(predict, mesh, in_specs), out_shardings=whole)


def _predict_all(network, images):
    """All that the network predicts of images, and the codes of their shapes."""
    features = network.encode(images)
    codes = features[:, : network.encoder.hidden]
    if network.is_tinted:
        codes = jnp.concatenate([codes, features[:, -TINT:]], axis=1)
    poses = network.predict_pose(features) | network.predict_camera(features)
    return network.predict_shape(features) | poses | {"codes": codes}


def _list_entries(output, state, arrays, quaternions, config, knows_distance):
    """What `_explain` reads of n views by name, and what scenes share.

    The points of a scene have the size that training has now, those of a shown one that
    which the schedule ends with: so images compare over training. What a view shows is
    in the base grid, and in the finest.
    """
    render, steps = config.render, config.train.steps
    kind = find_shape_class(config.network.shape)
    (scene, shared), (shown, shown_shared) = (
        kind.read(
            output,
            schedules.compute_sigma(step, render, steps=steps),
            render=render,
        ).list_scenes()
        for step in (state.step, steps)
    )
    if config.pose.known:
        poses = Poses(quaternions[:, None], quaternions, None)
    else:
        poses = complete_poses(output, state.averages.covariance, pose=config.pose)
    cameras = find_cameras(output, arrays, pose=config.pose)
    base, fine = (
        observe(
            *(arrays["masks"], cameras, side),
            config=config,
            knows_distance=knows_distance,
        )
        for side in (config.render.grid, config.render.finest)
    )
    entries = {
        "scene": scene,
        "shown": shown,
        "poses": poses,  # predicted, or given ones
        "chances": find_probabilities(poses),
        "image": arrays["images"],
        "mask": arrays["masks"],
        "base": base,
        "fine": fine,
    }
    return entries, (shared, shown_shared)


def _explain(entry, *, shared, scores, config):
    """What one view is taken for: images, poses, winner, and what candidates lose."""
    scene, shown = entry["scene"] | shared[0], entry["shown"] | shared[1]
    (candidates, taken, _), base, fine = entry["poses"], entry["base"], entry["fine"]
    heads, losses, chances = len(candidates), jnp.zeros(1), entry["chances"]
    if config.pose.weighs_fit and config.pose.elevations:
        known = candidates, chances, base
        candidates, chances = add_viewpoints(scene, *known, config=config)
    if len(candidates) > 1:
        losses = compare_poses(scene, candidates, base, config=config)
    if scores is not None:
        view = candidates, entry["image"], entry["mask"], base
        chances = weigh_by_colors(chances, scene, *view, scores=scores, config=config)
    if config.pose.weighs_fit:
        known = candidates, losses, chances, fine
        (taken,) = find_likeliest(scene, *known, count=1, config=config)
    losses, chances = losses[:heads], chances[:heads]
    chances /= jnp.maximum(jnp.sum(chances), jnp.finfo(chances.dtype).tiny)
    found = {"winners": jnp.argmin(losses), "poses": taken}
    found |= {"losses": losses, "probabilities": chances}
    return found | _render_images(shown, taken, fine.camera, config)


def _render_images(shown, pose, camera, config):
    """Images of a shape from a pose [4]: silhouettes, depths and colours if any."""
    is_asked = {
        "silhouette": True,
        "depth": not config.data.images or bool(config.data.test_meshes),
        "color": "colors" in shown,
    }
    signals = tuple(name for name, holds in is_asked.items() if holds)
    image = render_finest(shown, pose, camera, signals=signals, config=config)
    images = {"silhouettes": image.silhouette, "depths": image.depth}
    images["color_images"] = image.color
    return {n: a for n, a in images.items() if a is not None}


def arrange_views(dataset: DataSet) -> tuple[np.ndarray, np.ndarray]:
    """Indices (models, views) [n, V] of all views, in the layout of predictions.

    Where models differ in their number of views each view stands alone: V is 1 and n
    counts views.
    """
    counts = dataset.counts
    models = np.repeat(np.arange(len(counts)), counts)
    views = np.arange(len(models)) - np.repeat(np.cumsum(counts) - counts, counts)
    width = counts[0] if (counts == counts[0]).all() else 1
    return models.reshape(-1, width), views.reshape(-1, width)


def compile_predictor(predictor: Any, state: TrainState, config: Config):
    """Compile the predictor for `predict_all`; the cache of programs has it then.

    Args:
      state: one of the same shapes and devices; its values are not read.
    """

    def describe(*shape, dtype: Any = np.float32):
        return jax.ShapeDtypeStruct((VIEWS_AT_ONCE, *shape), dtype)

    square = (config.data.image_size,) * 2
    ends = {"depths": square, "translations": (3,), "focal_lengths": ()}
    views = (
        describe(*square, 3, dtype=np.uint8),
        describe(*square, dtype=np.uint8),
        describe(4),
        {name: describe(*ends[name]) for name in list_extras(config)},
    )
    like = jax.tree.map(
        lambda a: jax.ShapeDtypeStruct(a.shape, a.dtype, sharding=a.sharding), state
    )
    predictor.lower(like, *views).compile()


def predict_all(
    predictor: Callable,
    state: TrainState,
    dataset: DataSet,
    *,
    extras: Sequence[str] = (),
) -> Predictions:
    """Run the predictor over a data set, `VIEWS_AT_ONCE` at a time, the last padded.

    Views are read batch by batch: a set may be larger than the memory. The layout is
    that of `arrange_views`; poses that are not given are the identity.

    Args:
      extras: arrays as of `list_extras`; those that the set has are read.
    """
    (models, views), at_once = arrange_views(dataset), VIEWS_AT_ONCE
    total = models.size
    found = {}  # filled in place: volumes of voxel models are gigabytes
    for start in range(0, total, at_once):
        rows = np.minimum(np.arange(start, start + at_once), total - 1)
        chosen = models.reshape(-1)[rows], views.reshape(-1)[rows]
        if dataset.quaternions is None:
            poses = np.tile(np.array([1, 0, 0, 0], np.float32), (at_once, 1))
        else:
            poses = np.asarray(dataset.quaternions[chosen])
        images, masks = dataset.images[chosen], dataset.masks[chosen]
        given = {name: getattr(dataset, name) for name in extras}
        more = {n: np.asarray(a[chosen]) for n, a in given.items() if a is not None}
        output = predictor(state, np.asarray(images), np.asarray(masks), poses, more)
        for name, part in jax.device_get(output).items():
            if name not in found:
                found[name] = np.empty((total, *part.shape[1:]), part.dtype)
            found[name][start : start + at_once] = part[: total - start]
    merged = {n: a.reshape(*models.shape, *a.shape[1:]) for n, a in found.items()}
    return Predictions(**merged)
