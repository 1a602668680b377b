"""Shape and poses fitted to silhouettes, beginning with a prediction. Not in the paper.

Free points would fit a single silhouette perfectly and be worse from every other side.
So the shape changes through its code alone, along the directions in which codes of
validation views differ, and each is pulled back by its usual deviation: the most
probable code, given the silhouettes. Poses turn freely. Several views of an object
share a code; they begin with the mean of theirs.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from dpc_jax.config import Config
from dpc_jax.learning import devices, schedules
from dpc_jax.learning.inference.explanation import (
    compare_poses,
    observe,
    render_finest,
)
from dpc_jax.learning.inference.predictor import Predictions
from dpc_jax.learning.inference.search import FINALISTS, find_likeliest
from dpc_jax.learning.shapes import find_shape_class
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render import quaternion
from dpc_jax.render.batch import map_renders

OBJECTS_AT_ONCE = 16
COMPONENTS = 64  # directions in which codes differ that are told apart
STEPS = 40  # of Adam
POSE_RATE, CODE_RATE = 0.02, 0.2  # radians, deviations; both fall to a twentieth
# Of a pose one radian and a code one deviation away, per mean squared difference of
# pixels.
POSE_PULL, CODE_PULL = 0.01, 1e-4


class Evidence(NamedTuple):
    """What n objects of V views are fitted to.

    Attributes:
      codes: [n, F] to begin with, tints at the end. poses: [n, V, 4], predicted.
      candidates: [n, V, C, 4].
      probabilities: [n, V, C] that the student gives to candidates.
      masks: uint8 [n, V, S, S]. weights: [n, V] of views; 0 for one that fills up.
      cameras: of views, translation [n, V, 3] and focal_length [n, V] by name.
    """

    codes: Any
    poses: Any
    candidates: Any
    probabilities: Any
    masks: Any
    weights: Any
    cameras: dict[str, Any]


def join_views(
    found: Predictions, masks: np.ndarray, groups: Sequence[np.ndarray]
) -> Evidence:
    """What objects are fitted to.

    Args:
      found: predictions, whose views are numbered row by row.
      masks: [n, S, S] of all views.
      groups: the views of each object. Objects with fewer views than others have their
        last one repeated, without weight.
    """
    width = 1 << (max(map(len, groups)) - 1).bit_length()
    rows = np.stack([g[np.minimum(np.arange(width), len(g) - 1)] for g in groups])
    flat: Any = jax.tree.map(lambda array: array.reshape(-1, *array.shape[2:]), found)
    cameras = {"translation": flat.translations, "focal_length": flat.focal_lengths}
    return Evidence(
        codes=np.stack([flat.codes[group].mean(axis=0) for group in groups]),
        poses=flat.poses[rows],
        candidates=flat.candidates[rows],
        probabilities=flat.probabilities[rows],
        masks=masks[rows],
        weights=np.stack([np.arange(width) < len(g) for g in groups]).astype("f4"),
        cameras={name: a[rows] for name, a in cameras.items() if a is not None},
    )


def find_directions(codes: np.ndarray) -> np.ndarray:
    """Directions [k, F] in which codes [..., F] vary, as long as their deviations.

    The principal axes, `COMPONENTS` at most: a sum of them with normal weights is as
    far from the mean as codes usually are.

    Raises:
      ValueError: for fewer than two codes, which do not vary.
    """
    codes = np.asarray(codes, np.float64).reshape(-1, codes.shape[-1])
    if len(codes) < 2:
        raise ValueError(
            f"Expected at least two views to measure how codes vary, but got "
            f"{len(codes)}; use a run with more validation images."
        )
    away = codes - np.mean(codes, axis=0)
    _, sizes, axes = np.linalg.svd(away, full_matrices=False)
    deviations = sizes / np.sqrt(len(codes) - 1)
    return (deviations[:, None] * axes)[:COMPONENTS].astype(np.float32)


def refine_objects(
    refiner: Callable,
    state: NamedTuple,
    evidence: Evidence,
    directions: np.ndarray,
    *,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[dict[str, np.ndarray]]:
    """The n objects of the evidence, each with what `make_refiner` says of its views.

    `OBJECTS_AT_ONCE` at a time; the last ones are repeated.
    """
    total, parts = len(evidence.codes), []
    at_once = min(OBJECTS_AT_ONCE, 1 << (total - 1).bit_length())
    for start in range(0, total, at_once):
        rows = np.minimum(np.arange(start, start + at_once), total - 1)
        batch = jax.tree.map(lambda array, rows=rows: np.asarray(array)[rows], evidence)
        parts.append(jax.device_get(refiner(state, batch, directions)))
        if on_progress:
            on_progress(min(start + at_once, total), total)
    arrays = jax.tree.map(lambda *arrays: np.concatenate(arrays), *parts)
    objects = []
    for i, weights in enumerate(evidence.weights):
        one, count = {name: a[i] for name, a in arrays.items()}, int(weights.sum())
        views = {name: one[name][:count] for name in ("poses", "silhouettes")}
        objects.append(one | views | {"errors": one["errors"][:, :count]})
    return objects


def make_refiner(network: ShapePoseNetwork, config: Config) -> Callable:
    """The compiled function (state, evidence, directions [k, F]) -> dict of arrays.

    It has points [n, N, 3], colors [n, N, 3] where they are learned, poses [n, V, 4],
    silhouettes [n, V, D, D], and errors [n, 2, V], before and after: mean squared
    differences of silhouettes, per pixel. Objects are shared out over the devices.

    Without directions (k is 0) nothing is refined: objects are decoded from their
    codes. Of several views of an object, and where predictions weigh the fit, each
    view's pose is chosen first among all candidates, by the shape that they share. A
    single view is refined from the likeliest few, each with a shape of its own, and
    that of the least objective stays: a shape has to be bent further to fit a pose that
    is wrong.
    """

    def refine(state, evidence, directions):
        decode = functools.partial(_decode, state, network=network, config=config)
        poses = _choose_poses(decode, evidence, len(directions) > 0, config)
        fit = functools.partial(_fit, decode, evidence, directions, config)
        found = jax.lax.map(fit, jnp.moveaxis(poses, 2, 0))
        best = jnp.argmin(found.pop("costs"), axis=0), jnp.arange(len(poses))
        before = found.pop("before")[0]  # the first hypothesis is what was predicted
        result = {name: array[best] for name, array in found.items()}
        return result | {"errors": jnp.stack([before, result["errors"]], axis=1)}

    # Every device has the whole network: there are few objects.
    parts = devices.WHOLE, devices.OBJECTS, devices.WHOLE
    return jax.jit(devices.share_padded(refine, devices.make_mesh(config), parts))


def _decode(state, codes, *, network, config):
    """(what is predicted of codes, the scenes of it, what they share)."""
    sigma = schedules.compute_sigma(state.step, config.render, steps=config.train.steps)
    shape = network.apply(state.params, codes, method="predict_shape")
    read = find_shape_class(config.network.shape).read(
        shape, sigma, render=config.render
    )
    return shape, *read.list_scenes()


def _choose_poses(decode, evidence, is_bent, config):
    """The poses [n, V, H, 4] that views are refined from.

    By silhouettes: other signals are not at hand. The predicted pose is among the
    candidates, and counts as the likeliest of them.
    """
    is_alone = evidence.poses.shape[1] == 1
    if is_alone and not config.pose.weighs_fit:
        return evidence.poses[:, :, None]
    _, scenes, shared = decode(evidence.codes)
    candidates = jnp.concatenate(
        [evidence.poses[:, :, None], evidence.candidates], axis=2
    )
    given = evidence.probabilities
    probabilities = jnp.concatenate([jnp.max(given, 2, keepdims=True), given], axis=2)
    base, fine = (
        observe(evidence.masks, evidence.cameras, side, config=config)
        for side in (config.render.grid, config.render.finest)
    )
    count = FINALISTS if is_alone and is_bent else 1

    def rank(scene, candidates, probabilities, base, fine):
        losses = compare_poses(scene, candidates, base, config=config)
        known = candidates, losses, probabilities, fine
        return find_likeliest(scene, *known, count=count, config=config)

    views = candidates, probabilities, base, fine
    return _map_views(rank, scenes, shared, views, config)


def _fit(decode, evidence: Evidence, directions, config, poses):
    """Shapes and poses of least objective, begun with poses [n, V, 4]; see `refine`.

    The objective is beside them as costs [n].
    """
    seen, finest = (evidence.masks, evidence.cameras), config.render.finest
    targets = observe(*seen, finest, config=config).target

    def render(scene, pose, camera):
        return render_finest(scene, pose, camera, config=config).silhouette

    def measure(bent):
        """The objective [n], and what is shown of it."""
        weights, turns = bent
        changes = weights @ directions  # tints stay
        tints = evidence.codes.shape[1] - changes.shape[1]
        shape, scenes, shared = decode(
            evidence.codes + jnp.pad(changes, ((0, 0), (0, tints)))
        )
        turned = turn(poses, turns)
        views = turned, evidence.cameras
        images = _map_views(render, scenes, shared, views, config)
        errors = jnp.mean((images - targets) ** 2, axis=(2, 3))
        pulls = POSE_PULL * jnp.sum(turns**2, axis=-1)
        count = jnp.maximum(jnp.sum(evidence.weights, axis=1), 1)
        total = jnp.sum(evidence.weights * (errors + pulls), axis=1)
        cost = (total + CODE_PULL * jnp.sum(weights**2, axis=1)) / count
        known = {n: shape[n] for n in ("points", "colors") if n in shape}
        return cost, known | {"silhouettes": images, "errors": errors, "poses": turned}

    begun: Any = (
        jnp.zeros((len(poses), len(directions))),
        jnp.zeros_like(poses[..., 1:]),
    )
    found = _descend(measure, begun) if len(directions) else begun
    cost, shown = measure(found)
    return shown | {"costs": cost, "before": measure(begun)[1]["errors"]}


def _map_views(function, scenes, shared, views, config):
    """`function(scene, *view)` of the views [n, V, ...] of n objects."""
    at_once = config.render.renders_at_once

    def map_object(entry):
        scene, views = entry
        scene = {**scene, **shared}
        return map_renders(
            lambda view: function(scene, *view), views, renders_at_once=at_once
        )

    return map_renders(map_object, (scenes, views), renders_at_once=at_once)


def turn(poses: jax.Array, turns: jax.Array) -> jax.Array:
    """Quaternions [..., 4] after small rotations [..., 3] in the camera frame.

    A turn is twice the tangent of half its angle along its axis: near zero, radians.
    """
    ones = jnp.ones((*turns.shape[:-1], 1), turns.dtype)
    small = jnp.concatenate([ones, turns / 2], axis=-1).reshape(-1, 4)

    def apply(small, pose):
        return quaternion.normalize(quaternion.multiply(small, pose))

    return jax.vmap(apply)(small, poses.reshape(-1, 4)).reshape(poses.shape)


def _descend(measure, bent):
    """The codes' weights and the turns of poses of the least objective."""

    def fall(peak):
        return optax.adam(optax.cosine_decay_schedule(peak, STEPS, 0.05))

    optimizer = optax.multi_transform(
        {"codes": fall(CODE_RATE), "turns": fall(POSE_RATE)}, ("codes", "turns")
    )
    slope = jax.grad(lambda bent: jnp.sum(measure(bent)[0]))

    def step(carry, _):
        bent, state = carry
        updates, state = optimizer.update(slope(bent), state)
        return (optax.apply_updates(bent, updates), state), None

    (bent, _), _ = jax.lax.scan(step, (bent, optimizer.init(bent)), length=STEPS)
    return bent
