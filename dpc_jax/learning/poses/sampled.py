"""Poses drawn by their probabilities and learned by REINFORCE, as in MVC.

Tulsiani et al. (2018) draw one head for each view instead of comparing all. The pose
drawn has the ordinary gradient of its loss; the probabilities p of the heads have that
of the expected loss, of which (cost - baseline)·∇log p of the head drawn is an unbiased
sample (Williams, 1992), whatever the baseline.

Not theirs is the entropy of p as a reward: without it all views soon agree on one head,
from which no other is tried any more (docs/baselines.md).
"""

import functools
from collections.abc import Mapping

import jax
import jax.numpy as jnp

from dpc_jax.learning.choice.batch_choice import Winners
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.pose_prior import judge_poses
from dpc_jax.learning.poses.teaching import Lesson, Teaching, predict
from dpc_jax.learning.predictions import Poses
from dpc_jax.learning.recipe import Averages, Recipe, Term
from dpc_jax.networks import ShapePoseNetwork

_KEPT = 0.95  # of the baseline in a step
PRIOR = 0.1  # weight of the judge's prior, per pixel of the silhouette
ENTROPY = 0.05  # weight of a nat of entropy, in shares of the baseline


def teach(lesson: Lesson, *, recipe: Recipe) -> tuple[Averages, Teaching]:
    """One drawn candidate of each view; its cost teaches the probabilities."""
    averages, poses = predict(lesson, recipe=recipe)
    winners = draw_poses(poses, lesson.keys, views=lesson.features.shape[1])

    def settle(costs, averages):
        terms, cost = compare_drawn(
            lesson.params,
            poses,
            winners,
            costs,
            averages.cost,
            lesson.keys,
            network=recipe.network,
            weight=PRIOR * recipe.render.grid**2,
        )
        return averages._replace(cost=cost), terms

    metrics = {"winners": winners.indices.reshape(-1)}
    return averages, Teaching(winners.poses, {}, metrics, settle)


def draw_poses(poses: Poses, keys: jax.Array, *, views: int) -> Winners:
    """One candidate of each view, by the softmax of the logits.

    Args:
      poses: candidates [B·V, K, 4] and logits [B·V, K].
      keys: [B], of the objects. views: V.
    """
    assert poses.logits is not None
    count = poses.logits.shape[-1]
    logits = jax.lax.stop_gradient(poses.logits).reshape(-1, views, count)
    own = jax.vmap(functools.partial(jax.random.fold_in, data=1))(keys)
    indices = jax.vmap(jax.random.categorical)(own, logits)
    drawn = jnp.take_along_axis(
        poses.candidates, indices.reshape(-1)[:, None, None], axis=1
    )
    return Winners(drawn.reshape(-1, views, 4), indices.astype(jnp.int32))


def compare_drawn(
    params: Mapping,
    poses: Poses,
    winners: Winners,
    costs: jax.Array,
    baseline: jax.Array | None,
    keys: jax.Array,
    *,
    network: ShapePoseNetwork,
    weight: float,
) -> tuple[dict[str, Term], jax.Array]:
    """What probabilities learn, and the prior of the poses drawn.

    Args:
      params: of the network. poses: of B·V views. winners: those drawn.
      costs: [B·V] of the renders of these. baseline: (), of the steps before.
      keys: [B], of the objects.
      weight: of the prior's losses beside these costs.

    Returns:
      (losses by name, the new baseline).
    """
    unlikely, judge = judge_poses(params, winners.poses, keys, network=network)
    terms = {"prior": Term(jnp.mean(unlikely), weight), "judge": Term(judge, 1.0)}
    costs = costs + weight * unlikely
    assert baseline is not None
    baseline = update_baseline(baseline, costs, axis=AXIS)
    indices = winners.indices.reshape(-1)
    assert poses.logits is not None
    loss = reinforce_loss(poses.logits, indices, costs, baseline)
    entropy = measure_entropy(poses.logits)
    terms |= {"reinforce": Term(loss, 1.0)}
    return terms | {"head_entropy": Term(entropy, -ENTROPY * baseline)}, baseline


def update_baseline(
    baseline: jax.Array, costs: jax.Array, *, axis: str | None = None
) -> jax.Array:
    """The moving average () of costs [...], after one more batch; from 0 on.

    Devices along a named axis, each with its share of the batch, get that of all.
    """
    mean = jnp.mean(jax.lax.stop_gradient(costs))
    if axis is not None:
        mean = jax.lax.pmean(mean, axis)
    return _KEPT * baseline + (1 - _KEPT) * mean


def reinforce_loss(
    logits: jax.Array, indices: jax.Array, costs: jax.Array, baseline: jax.Array
) -> jax.Array:
    """Mean of (cost - baseline)·log p of the heads drawn; ().

    Its value means nothing; its gradient by the logits is that of the expected cost.

    Args:
      logits: [n, K]. indices: [n] of the heads drawn.
      costs: [n], without gradient. baseline: ().
    """
    chances = jax.nn.log_softmax(logits)
    drawn = jnp.take_along_axis(chances, indices[:, None], axis=1)[:, 0]
    return jnp.mean(jax.lax.stop_gradient(costs - baseline) * drawn)


def measure_entropy(logits: jax.Array) -> jax.Array:
    """Mean entropy () of the probabilities of logits [n, K]; nats, 0 to ln K."""
    chances = jax.nn.log_softmax(logits)
    return -jnp.mean(jnp.sum(jnp.exp(chances) * chances, axis=-1))
