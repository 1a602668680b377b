"""Half turns that were decided are kept until the shapes have followed them.

A shape that turns round passes one that fits both ways alike. There its views find one
way or the other, each for itself, and it stays half way. So the pose that a view was
turned to is remembered, and its winners are turned there until the shape fits.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning.devices import AXIS
from dpc_jax.render import quaternion

_PLACES = 2**14  # of views; half a megabyte


class Decisions(NamedTuple):
    """Poses that views were turned to, at the places that their numbers give.

    Attributes:
      poses: [PLACES, 4] quaternions. owners: [PLACES] int32 numbers of their views, -1
        for none; a view whose place another one takes is forgotten.
    """

    poses: jax.Array
    owners: jax.Array


def start_decisions() -> Decisions:
    """None yet."""
    return Decisions(jnp.zeros((_PLACES, 4)), jnp.full(_PLACES, -1, jnp.int32))


def keep_turns(
    decisions: Decisions,
    wanted: jax.Array,
    fits: jax.Array,
    poses: jax.Array,
    turns: jax.Array,
    view_ids: jax.Array,
) -> tuple[jax.Array, Decisions]:
    """Turns of views: what is wanted now, or was before and is not followed yet.

    Args:
      wanted: [B] turns of objects; 0 for none. fits: [B] whether they clearly fit as
        they are. poses: [B·V, 4] of winners. turns: [T, 4] of objects.
      view_ids: [B·V] int32.

    Returns:
      ([B·V] turns, the decisions with those of now).
    """
    views = len(poses) // len(wanted)
    recalled = _recall(decisions, poses, turns, view_ids).reshape(-1, views)
    of_views, is_new = _settle(wanted, fits, recalled, count=len(turns))
    turned = of_views.reshape(-1)
    poses = jax.vmap(quaternion.multiply)(poses, turns[turned])
    is_new = jnp.repeat(is_new, views)
    return turned, _remember(decisions, poses, view_ids, is_new)


def _recall(decisions, poses, turns, view_ids):
    """The turns that bring poses [n, 4] next to the decided ones; [n], -1 for none."""

    def find(pose, view):
        place = view % _PLACES
        ways = jax.vmap(lambda turn: quaternion.multiply(pose, turn))(turns)
        near = jnp.argmax(jnp.abs(jnp.sum(ways * decisions.poses[place][None], axis=1)))
        return jnp.where(decisions.owners[place] == view, near, -1)

    return jax.vmap(find)(poses, view_ids)


def _settle(wanted, fits, recalled, *, count):
    """([B, V] turns, [B] whether they are decided now) of [B, V] recalled ones."""
    votes = jnp.sum(jax.nn.one_hot(recalled, count), axis=1)  # [B, T]
    total = jnp.sum(votes, axis=1)
    is_kept = (total > 0) & ~fits
    has_followed = votes[:, 0] > total / 2
    is_new = (wanted > 0) & (has_followed | ~is_kept)
    usual = jnp.argmax(votes, axis=1)[:, None]
    kept = jnp.where(recalled < 0, usual, recalled) * is_kept[:, None]
    return jnp.where(is_new[:, None], wanted[:, None], kept), is_new


def _remember(decisions, poses, view_ids, is_new):
    """With the poses [n, 4] of the views where [n] they are new, of all devices."""
    places = jnp.where(is_new, view_ids % _PLACES, _PLACES)  # beyond the end: dropped
    places, poses, view_ids = (
        jax.lax.all_gather(a, AXIS, tiled=True) for a in (places, poses, view_ids)
    )
    return Decisions(
        decisions.poses.at[places].set(poses, mode="drop"),
        decisions.owners.at[places].set(view_ids, mode="drop"),
    )
