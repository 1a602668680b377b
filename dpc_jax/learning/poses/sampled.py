"""Poses drawn by their probabilities and learned by REINFORCE, as in MVC.

Tulsiani et al. (2018) draw one head for each view instead of comparing all. The pose
drawn has the ordinary gradient of its loss; the probabilities p of the heads have that
of the expected loss, of which (cost - baseline)·∇log p of the head drawn is an unbiased
sample (Williams, 1992), whatever the baseline.

The heads may agree on one side of the object. A judge that learns against them tells
predicted poses from poses drawn as the views were: azimuths uniform, elevations uniform
in their range, no roll (Goodfellow et al., 2014).

Not theirs is the entropy of p as a reward: without it all views soon agree on one head,
from which no other is tried any more (docs/baselines.md).
"""

import functools
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import optax

from dpc_jax.learning.candidates import Poses
from dpc_jax.learning.choice.hindsight import Winners
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.losses import Term
from dpc_jax.learning.poses.source import ForwardPass, ViewPoses, predict_candidates
from dpc_jax.learning.recipe import Recipe
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.networks.viewpoints import face_object

_KEPT = 0.95  # of the baseline in a step
PRIOR = 0.1  # weight of the judge's prior, per pixel of the silhouette
ENTROPY = 0.05  # weight of a nat of entropy, in shares of the baseline


def find_poses(forward: ForwardPass, *, recipe: Recipe) -> ViewPoses:
    """One drawn candidate of each view; its cost teaches the probabilities."""
    averages, poses = predict_candidates(forward, recipe=recipe)
    winners = draw_poses(poses, forward.keys)
    logits, indices = poses.logits, winners.indices
    before = averages.cost
    assert logits is not None and before is not None

    def find_cost_terms(costs):
        unlikely, judge = judge_poses(
            forward.params, winners.poses, forward.keys, network=recipe.network
        )
        weight = PRIOR * recipe.render.grid**2
        terms = {"prior": Term(jnp.mean(unlikely), weight), "judge": Term(judge)}
        costs = costs + weight * unlikely
        mean = jax.lax.pmean(jnp.mean(jax.lax.stop_gradient(costs)), AXIS)
        baseline = _KEPT * before + (1 - _KEPT) * mean
        loss = reinforce_loss(logits, indices, costs, baseline)
        terms["reinforce"] = Term(loss)
        terms["head_entropy"] = Term(measure_entropy(logits), -ENTROPY * baseline)
        return averages._replace(cost=baseline), terms

    return ViewPoses(winners.poses, {}, {"winners": indices}, find_cost_terms)


def draw_poses(poses: Poses, keys: jax.Array) -> Winners:
    """One candidate of each view, by the softmax of the logits.

    Args:
      poses: candidates [n, K, 4] and logits [n, K]. keys: [n], of the views.
    """
    assert poses.logits is not None
    logits = jax.lax.stop_gradient(poses.logits)
    own = jax.vmap(functools.partial(jax.random.fold_in, data=1))(keys)
    indices = jax.vmap(jax.random.categorical)(own, logits)
    drawn = jnp.take_along_axis(poses.candidates, indices[:, None, None], axis=1)
    return Winners(drawn[:, 0], indices.astype(jnp.int32))


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


def judge_poses(
    params: Mapping,
    quaternions: jax.Array,
    keys: jax.Array,
    *,
    network: ShapePoseNetwork,
) -> tuple[jax.Array, jax.Array]:
    """What predicted poses lose [n], and what the judge loses ().

    Both are cross entropies in nats. The first has no gradient by the judge, the second
    none by the poses.

    Args:
      params: of the network, the judge's among them.
      quaternions: [n, 4], of any length but zero. keys: [n], of the views.
    """
    own = jax.vmap(functools.partial(jax.random.fold_in, data=2))(keys)
    draw = functools.partial(_draw_prior, elevations=network.pose.elevations)
    drawn, signs = jax.vmap(draw)(own)
    length = jnp.linalg.norm(quaternions, axis=-1, keepdims=True)
    # q and -q are one pose: neither sign may give it away.
    predicted = signs[:, None] * quaternions / length

    def judge(params, poses, label):
        logits: Any = network.apply(params, poses, method=lambda net, q: net.judge(q))
        labels = jnp.full_like(logits, label)
        return optax.losses.sigmoid_binary_cross_entropy(logits, labels)

    stop = jax.lax.stop_gradient
    losses = judge(stop(params), predicted, 1.0)
    found = judge(params, stop(predicted), 0.0)
    right = judge(params, drawn, 1.0)
    return losses, jnp.mean(found) + jnp.mean(right)


def _draw_prior(key, *, elevations):
    """A pose [4] by the prior, and a random sign () for the predicted one."""
    azimuth, height, sign, other = jax.random.split(key, 4)
    low, high = (jnp.deg2rad(angle) for angle in elevations)
    pose = face_object(
        jax.random.uniform(azimuth, maxval=2 * jnp.pi),
        jax.random.uniform(height, minval=low, maxval=high),
    )
    own = jax.random.rademacher(sign, dtype=jnp.float32)
    return own * pose, jax.random.rademacher(other, dtype=jnp.float32)
