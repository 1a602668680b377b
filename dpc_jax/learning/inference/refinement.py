"""Shape and poses fitted to silhouettes, beginning with a prediction. Not in the paper.

Free points would fit a single silhouette perfectly and be worse from every other side.
So the shape changes through its code alone, along the directions in which codes of
validation views differ, and each is pulled back by its usual deviation: the most
probable code, given the silhouettes. Poses turn freely. Several views of an object
share a code; they begin with the mean of theirs.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from dpc_jax.config import Config
from dpc_jax.learning import devices, schedules
from dpc_jax.learning.cameras import place_camera
from dpc_jax.learning.inference.codes import make_shared
from dpc_jax.learning.inference.explanation import (
    compare_candidates,
    kind_of,
    rank_finely,
)
from dpc_jax.learning.inference.viewpoint_search import search_nearby
from dpc_jax.learning.losses import downsample_images
from dpc_jax.learning.shapes.kind import Scene, View
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render import Camera, quaternion
from dpc_jax.render.batch import map_renders

OBJECTS_AT_ONCE = 16


@dataclasses.dataclass(frozen=True)
class RefineSettings:
    """How predictions are refined.

    Attributes:
      steps: of Adam; 0 leaves shapes and poses as they are.
      pose_rate: learning rate of poses, radians. code_rate: of codes, deviations. Both
        fall to a twentieth.
      code_pull: of a code one deviation away, per mean squared difference of pixels.
      pose_pull: of a pose one radian away, likewise.
      is_rechosen: whether each view's pose is first chosen among all candidates by the
        shape that the views share, as the run's predictions are (`pose.student`) but
        by silhouettes alone.
      hypotheses: of objects of one view, how many of its likeliest candidates are
        refined, each with a shape of its own; that of the least objective stays. A
        shape has to be bent further to fit a pose that is wrong. `FINALISTS` at most;
        with more than 1 poses are chosen anew.
    """

    steps: int = 40
    pose_rate: float = 0.02
    code_rate: float = 0.2
    code_pull: float = 1e-4
    pose_pull: float = 0.01
    is_rechosen: bool = False
    hypotheses: int = 1


class Evidence(NamedTuple):
    """What n objects of V views are fitted to.

    Attributes:
      codes: [n, F] to begin with, with tints [n, F + 3]. poses: [n, V, 4].
      candidates: [n, V, C, 4].
      probabilities: [n, V, C] that the student gives to candidates.
      masks: uint8 [n, V, S, S]. weights: [n, V] of views; 0 for one that fills up.
      own: of views' cameras, translation [n, V, 3] and focal_length [n, V] by name.
    """

    codes: Any
    poses: Any
    candidates: Any
    probabilities: Any
    masks: Any
    weights: Any
    own: dict[str, Any]


@functools.lru_cache(maxsize=8)  # of one run there are four
def make_refiner(
    network: ShapePoseNetwork, config: Config, settings: RefineSettings
) -> Callable:
    """The compiled function (state, evidence, directions [k, F]) -> dict of arrays.

    It has points [n, N, 3], colors [n, N, 3] where they are learned, poses [n, V, 4],
    silhouettes [n, V, D, D], and errors_before and errors [n, V]: mean squared
    differences of silhouettes, per pixel. Objects are shared out over the devices.
    """
    render, kind = config.render, kind_of(config)
    side = render.finest

    def refine(state, evidence, directions):
        sigma = schedules.compute_sigma(state.step, render, steps=config.train.steps)

        def decode(codes):
            shape = network.apply(state.params, codes, method="predict_shape")
            assert isinstance(shape, dict)
            read = kind.read(shape, sigma, render=render)
            return shape, *read.list_scenes()

        evidence, count = _begin_anew(decode, evidence, settings, config)
        poses, targets = evidence.poses, downsample_images(evidence.masks, side)

        def compare(weights, turns):
            bent = weights @ directions  # tints stay
            tints = evidence.codes.shape[1] - bent.shape[1]
            bent = jnp.pad(bent, ((0, 0), (0, tints)))
            shape, scenes, shared = decode(evidence.codes + bent)
            scenes = kind.weigh_as_trained(scenes, render)
            images = _render_objects(
                scenes, shared, turn(poses, turns), evidence.own, side, config
            )
            errors = jnp.mean((images - targets) ** 2, axis=(2, 3))
            return errors, images, shape

        def measure(learned):
            weights, turns = learned
            errors, *_ = compare(weights, turns)
            pulls = settings.pose_pull * jnp.sum(turns**2, axis=-1)
            views = jnp.maximum(jnp.sum(evidence.weights, axis=1), 1)
            total = jnp.sum(evidence.weights * (errors + pulls), axis=1)
            total += settings.code_pull * jnp.sum(weights**2, axis=1)
            return total / views

        begun = (
            jnp.zeros((len(poses), len(directions))),
            jnp.zeros((*poses.shape[:2], 3)),
        )
        before, *_ = compare(*begun)
        found: Any = _descend(lambda x: jnp.sum(measure(x)), begun, settings)
        errors, images, shape = compare(*found)
        result = {name: shape[name] for name in ("points", "colors") if name in shape}
        result |= {"silhouettes": images, "errors": errors}
        result["poses"] = turn(poses, found[1])
        result = take_best(measure(found).reshape(-1, count), result)
        # The first hypothesis is what was predicted.
        return result | {"errors_before": before[::count]}

    return make_shared(refine, config, devices.OBJECTS, devices.WHOLE)


def _begin_anew(decode, evidence, settings, config):
    """(the evidence with poses chosen anew, hypotheses of an object), where asked."""
    if not settings.is_rechosen and settings.hypotheses == 1:
        return evidence, 1
    _, scenes, shared = decode(evidence.codes)
    asked = settings.hypotheses
    likeliest = rank_poses(scenes, shared, evidence, config, count=asked)
    return list_hypotheses(evidence, likeliest), likeliest.shape[2]


def turn(poses: jax.Array, turns: jax.Array) -> jax.Array:
    """Quaternions [..., 4] after small rotations [..., 3] in the camera frame.

    A turn is twice the tangent of half its angle along its axis: near zero, radians.
    """
    ones = jnp.ones((*turns.shape[:-1], 1), turns.dtype)
    small = jnp.concatenate([ones, turns / 2], axis=-1).reshape(-1, 4)

    def apply(small, pose):
        return quaternion.normalize(quaternion.multiply(small, pose))

    return jax.vmap(apply)(small, poses.reshape(-1, 4)).reshape(poses.shape)


def _descend(measure, learned, settings: RefineSettings):
    """The codes' weights and the turns of poses of the least error."""
    if not settings.steps:
        return learned

    def fall(peak):
        return optax.adam(optax.cosine_decay_schedule(peak, settings.steps, 0.05))

    rates: Any = {
        "codes": fall(settings.code_rate),
        "turns": fall(settings.pose_rate),
    }
    optimizer = optax.multi_transform(rates, ("codes", "turns"))

    def step(carry, _):
        learned, state = carry
        updates, state = optimizer.update(jax.grad(measure)(learned), state)
        return (optax.apply_updates(learned, updates), state), None

    (learned, _), _ = jax.lax.scan(
        step, (learned, optimizer.init(learned)), length=settings.steps
    )
    return learned


def _render_objects(scenes, shared, poses, own, side, config):
    """Silhouettes [n, V, D, D] of n objects from V views each."""
    render, kind = config.render, kind_of(config)
    camera = Camera(render.focal_length, render.distance)

    def render_object(entry):
        scene, poses, own = entry
        scene = kind.resize(scene | shared, side / render.grid)

        def render_view(view):
            pose, own = view
            seen = View(
                pose,
                place_camera(camera, own),
                side,
                own.get("translation"),
                render.ray_rule,
            )
            return kind.render(scene, seen, signals=("silhouette",)).silhouette

        at_once = render.renders_at_once
        return map_renders(render_view, (poses, own), renders_at_once=at_once)

    return map_renders(
        render_object, (scenes, poses, own), renders_at_once=render.renders_at_once
    )


def refine_all(
    refiner: Callable,
    state: NamedTuple,
    evidence: Evidence,
    directions: np.ndarray,
    *,
    on_progress: Callable[[int, int], None] | None = None,
) -> dict[str, np.ndarray]:
    """Refine n objects, `OBJECTS_AT_ONCE` at a time (the last ones are repeated)."""
    total, parts = len(evidence.codes), []
    at_once = min(OBJECTS_AT_ONCE, 1 << (total - 1).bit_length())
    for start in range(0, total, at_once):
        rows = np.minimum(np.arange(start, start + at_once), total - 1)
        batch = jax.tree.map(lambda array, rows=rows: np.asarray(array)[rows], evidence)
        parts.append(jax.device_get(refiner(state, batch, directions)))
        if on_progress:
            on_progress(min(start + at_once, total), total)
    return jax.tree.map(lambda *arrays: np.concatenate(arrays)[:total], *parts)


def rank_poses(
    scenes: Scene, shared: Scene, evidence: Evidence, config: Config, *, count: int
) -> jax.Array:
    """Of each view, the poses [n, V, F, 4] that its object's shape fits best.

    By silhouettes: other signals are not at hand. Where predictions are posteriors so
    are these. Else the student's pose is among the candidates, and counts as any. A
    single one is searched for nearby as predictions are; of several, a fit has to
    find out which is right, and moves them anyway.

    Args:
      scenes, shared: of n objects' shapes.
      count: F, how many; fewer where there are fewer candidates or `FINALISTS`.
    """
    render = config.render
    candidates, probabilities = evidence.candidates, evidence.probabilities
    if not config.pose.weighs_fit:
        candidates = jnp.concatenate([evidence.poses[:, :, None], candidates], axis=2)
        probabilities = jnp.ones(candidates.shape[:-1])
    targets = downsample_images(evidence.masks, render.grid)
    fine_targets = downsample_images(evidence.masks, render.finest)

    def rank(entry):
        scene, *views = entry
        return map_renders(
            functools.partial(rank_view, {**scene, **shared}),
            tuple(views),
            renders_at_once=render.renders_at_once,
        )

    def rank_view(scene, view):
        poses, probabilities, target, fine_target, own = view
        losses = compare_candidates(scene, poses, target, own, config=config)
        likeliest = rank_finely(
            scene, poses, losses, probabilities, fine_target, own, config=config
        )
        if count == 1 and config.pose.searches:
            best = poses[likeliest[0]]
            return search_nearby(scene, best, fine_target, own, config=config)[None]
        return poses[likeliest[:count]]

    return map_renders(
        rank,
        (scenes, candidates, probabilities, targets, fine_targets, evidence.own),
        renders_at_once=render.renders_at_once,
    )


def list_hypotheses(evidence: Evidence, likeliest: jax.Array) -> Evidence:
    """Each object F times, with one of the likeliest poses [n, V, F, 4] each."""
    count = likeliest.shape[2]
    if count == 1:
        return evidence._replace(poses=likeliest[:, :, 0])
    repeated = jax.tree.map(lambda array: jnp.repeat(array, count, axis=0), evidence)
    poses = jnp.swapaxes(likeliest, 1, 2)  # as many objects of V views
    return repeated._replace(poses=poses.reshape(-1, *poses.shape[2:]))


def take_best(costs: jax.Array, result: Any) -> Any:
    """Of the arrays [n·H, ...] those of the least of the costs [n, H]."""
    rows = jnp.arange(len(costs)) * costs.shape[1] + jnp.argmin(costs, axis=1)
    return jax.tree.map(lambda array: array[rows], result)
