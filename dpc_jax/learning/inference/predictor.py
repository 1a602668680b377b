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
from dpc_jax.evaluation.alignment import Alignment, place_poses
from dpc_jax.learning import devices, schedules
from dpc_jax.learning.cameras import find_cameras, list_own
from dpc_jax.learning.inference.explanation import (
    compare_candidates,
    compare_poses,
    kind_of,
    list_compared,
    rank_finely,
    show_view,
    weigh_finest,
)
from dpc_jax.learning.inference.viewpoint_search import search_nearby
from dpc_jax.learning.losses import downsample_images
from dpc_jax.learning.predictions import (
    complete_poses,
    find_probabilities,
    make_inputs,
)
from dpc_jax.learning.signals import list_extras
from dpc_jax.learning.step import TrainState, find_parts
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.networks.columns import sharing_columns
from dpc_jax.render.batch import map_renders

VIEWS_AT_ONCE = 64  # that are predicted: a batch of a data set


class Predictions(NamedTuple):
    """What the network says of M models with V views each, in its own frame.

    Attributes:
      points: [M, V, N, 3], the shape predicted from each view; of voxel models none
        until `volumes.add_points`.
      colors: [M, V, N, 3], or None.
      poses: [M, V, 4], predicted: the student's quaternion, or that of the largest
        posterior (`pose.student`), a viewpoint then searched for nearby; the given
        one where poses are known.
      candidate_poses: [M, V, 4], the candidate, turned or not, that fits the view best.
      winners: [M, V] its index; of head index % K, whether turned or not.
      silhouettes: [M, V, D, D], the shape seen from the predicted pose, its points of
        the size that the schedule ends with.
      depths: [M, V, D, D], color_images: [M, V, D, D, 3] of the same render; None for
        data without depths, and where no colours are learned.
      translations: [M, V, 3], focal_lengths: [M, V] as predicted; None where they are
        not learned.
      sizes: [M, V, N] sigmas in voxels of the base grid, or [M, V, N, 3, 3] covariances
        in voxels², where they are learned; else None.
      costs: [M, V, 2] of the silhouette in the finest grid as seen from the predicted
        pose and from the true one; without a frame (`predict_all`) of no meaning.
      cells: [M, V, D, D, D], the occupancies that voxel models predict; else None.
      candidates: [M, V, C, 4], turned ones included, and probabilities: [M, V, C] that
        the student gives them, alike where it does not select. Only where asked for.
    """

    points: np.ndarray
    poses: np.ndarray
    candidate_poses: np.ndarray
    winners: np.ndarray
    silhouettes: np.ndarray
    colors: np.ndarray | None = None
    depths: np.ndarray | None = None
    color_images: np.ndarray | None = None
    translations: np.ndarray | None = None
    focal_lengths: np.ndarray | None = None
    sizes: np.ndarray | None = None
    cells: np.ndarray | None = None
    costs: np.ndarray | None = None
    candidates: np.ndarray | None = None
    probabilities: np.ndarray | None = None


class View(NamedTuple):
    """One of n views, with what a network predicts for it.

    Attributes:
      scene, shown: of the shape, its points of the size that training has now, and of
        that which the schedule ends with: so images compare over training.
      pose: [4] of the student. chances: [C] that it gives to the candidates [C, 4].
      given: [4], the pose of the data.
      target: [D, D] silhouette in the base grid, own: what the view has of its own,
        see `compare_poses`. fine_target, fine: the same in the finest grid.
    """

    scene: Any
    shown: Any
    pose: Any
    chances: Any
    given: Any
    candidates: Any
    target: Any
    own: Any
    fine_target: Any
    fine: Any


def make_predictor(
    network: ShapePoseNetwork, config: Config, *, keeps_candidates: bool = False
) -> Callable:
    """The compiled function (state, images, masks, quaternions, extras) -> dict.

    It runs over the devices. For n views: images uint8 [n, S, S, 3], masks uint8
    [n, S, S], quaternions [n, 4], extras: arrays [n, ...] of `list_extras`, those there
    are. The dictionary has the fields of `Predictions`, with one leading axis [n];
    those that a run does not have are left out, and so are candidates and their
    probabilities unless they are kept.
    """

    def predict(state, images, masks, quaternions, extras):
        with sharing_columns(devices.AXIS):
            inputs = make_inputs(images, masks, network=network)
            output: Any = network.apply(state.params, inputs)
        views, shared = _list_views(
            output,
            state,
            {"images": images, "masks": masks, **extras},
            quaternions,
            config=config,
        )
        explained = map_renders(
            functools.partial(_explain, shared=shared, config=config),
            views,
            renders_at_once=config.render.renders_at_once,
        )
        candidates = views.candidates
        best = jax.vmap(lambda q, k: q[k])(candidates, explained["winners"])
        result = explained | {"candidate_poses": best}
        names = ("translations", "focal_lengths")
        result |= {name: output[name] for name in names if name in output}
        if keeps_candidates and not config.pose.known:
            result |= {"candidates": candidates, "probabilities": views.chances}
        return result | kind_of(config).find_evaluated(output, views.scene)

    mesh = devices.make_mesh(config)
    parts = find_parts(network, config, mesh)
    # Every process of a job gets all of it.
    whole = NamedSharding(mesh, devices.WHOLE) if jax.process_count() > 1 else None
    in_specs = (parts, *[devices.OBJECTS] * 4)
    return jax.jit(devices.share_padded(predict, mesh, in_specs), out_shardings=whole)


def _list_views(output, state, arrays, quaternions, *, config):
    """(`View` of all n, (scenes that they share, of scene and shown))."""
    render, kind, steps = config.render, kind_of(config), config.train.steps
    sigma, last = (
        schedules.compute_sigma(step, render, steps=steps)
        for step in (state.step, steps)
    )
    scene, shared = kind.read(output, sigma, render=render).list_scenes()
    shown, shown_shared = kind.read(output, last, render=render).list_scenes()
    shown = kind.weigh_as_trained(shown, render)
    candidates, students = quaternions[:, None], quaternions
    chances = jnp.ones((len(quaternions), 1))
    if not config.pose.known:
        poses = complete_poses(output, state.covariance, pose=config.pose)
        candidates, students = poses.candidates, poses.student
        chances = find_probabilities(poses)
    cameras = list_own(find_cameras(output, arrays, pose=config.pose), len(quaternions))
    (target, own), (fine_target, fine) = (
        (
            downsample_images(arrays["masks"], side),
            cameras | list_compared(arrays, side, config),
        )
        for side in (render.grid, render.finest)
    )
    views = View(
        *(scene, shown, students, chances, quaternions, candidates),
        *(target, own, fine_target, fine),
    )
    return views, (shared, shown_shared)


def _explain(view, *, shared, config):
    """What one view is taken for: images, poses, winner, and what poses cost."""
    scene, shown = view.scene | shared[0], view.shown | shared[1]
    winner, taken = _choose(view, scene, config)
    found = {"winners": winner, "poses": taken}
    found |= show_view(shown, taken, view.own, config=config)
    if not config.pose.known:
        both = jnp.stack([taken, view.given])
        finer = weigh_finest(scene, config)
        found["costs"] = compare_poses(
            finer, both, view.fine_target, view.own, config=config
        )
    return found


def _choose(view, scene, config):
    """(index of the candidate that fits best, the pose that is predicted)."""
    candidates, pose = view.candidates, config.pose
    if len(candidates) == 1:
        return jnp.zeros((), jnp.int32), view.pose
    losses = compare_candidates(scene, candidates, view.target, view.own, config=config)
    winner, taken = jnp.argmin(losses), view.pose
    if pose.weighs_fit:
        fine = view.fine_target, view.fine
        likeliest = rank_finely(
            scene, candidates, losses, view.chances, *fine, config=config
        )
        taken = candidates[likeliest[0]]
        if pose.searches:
            taken = search_nearby(scene, taken, *fine, config=config)
    return winner, taken


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
      predictor: of `make_predictor`.
      state: one of the same shapes and devices; its values are not read.
    """

    def describe(*shape, dtype):
        return jax.ShapeDtypeStruct((VIEWS_AT_ONCE, *shape), dtype)

    size = config.data.image_size
    ends = {"depths": (size, size), "translations": (3,), "focal_lengths": ()}
    views = (
        describe(size, size, 3, dtype=np.uint8),
        describe(size, size, dtype=np.uint8),
        describe(4, dtype=np.float32),
        {n: describe(*ends[n], dtype=np.float32) for n in list_extras(config)},
    )
    held = jax.tree.map(
        lambda a: jax.ShapeDtypeStruct(a.shape, a.dtype, sharding=a.sharding), state
    )
    predictor.lower(held, *views).compile()


def predict_all(
    predictor: Callable,
    state: TrainState,
    dataset: DataSet,
    *,
    views_at_once: int = VIEWS_AT_ONCE,
    extras: Sequence[str] = (),
    frame: Alignment | None = None,
) -> Predictions:
    """Run the predictor over a data set in equal batches (the last one is padded).

    Views are read batch by batch: a set may be larger than the memory. The layout is
    that of `arrange_views`; poses that are not given are the identity. Of the extras,
    arrays of the data set as of `list_extras`, those that it has are read. The frame
    is that of the network, in which the true poses are compared with the predicted
    ones; None where the network's frame is that of the data.
    """
    models, views = arrange_views(dataset)
    total = models.size
    found = {}  # filled in place: volumes of voxel models are gigabytes
    for start in range(0, total, views_at_once):
        rows = np.minimum(np.arange(start, start + views_at_once), total - 1)
        chosen = models.reshape(-1)[rows], views.reshape(-1)[rows]
        if dataset.quaternions is None:
            poses = np.tile(np.array([1, 0, 0, 0], np.float32), (views_at_once, 1))
        else:
            poses = np.asarray(dataset.quaternions[chosen])
            if frame is not None:
                poses = place_poses(frame, poses).astype(np.float32)
        images, masks = dataset.images[chosen], dataset.masks[chosen]
        given = {name: getattr(dataset, name) for name in extras}
        more = {n: np.asarray(a[chosen]) for n, a in given.items() if a is not None}
        output = predictor(state, np.asarray(images), np.asarray(masks), poses, more)
        for name, part in jax.device_get(output).items():
            if name not in found:
                found[name] = np.empty((total, *part.shape[1:]), part.dtype)
            found[name][start : start + views_at_once] = part[: total - start]
    merged = {n: a.reshape(*models.shape, *a.shape[1:]) for n, a in found.items()}
    return Predictions(**merged)
