"""Where the category's cameras stand: candidates seen from elsewhere are handicapped.

Not in the paper. Photographs are taken upright, and mostly from a little above. In the
network's frame the cameras of a category then circle around one axis: the direction
that is least along their images' rows. Their elevations above its plane and their rolls
about the line of sight are counted by moving sums over batches. A kind that lives
turned round an oblique axis (stools whose seat lies where other chairs have their
back), or a mirror pose (from below for from above), has cameras where the others have
none, though its silhouettes agree.

Nothing is assumed of a set whose cameras stand anywhere: its densities are even, and no
candidate has a handicap.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.learning.devices import AXIS
from dpc_jax.render import quaternion

ELEVATIONS, ROLLS = 18, 24  # bins of 10° and of 15°
_KEPT = 0.99  # of the sums in a step: 100 batches
_PRIOR = 0.05  # share of a bin's even density that it has at least
_BLUR = (0.25, 0.5, 0.25)  # of counts


class Viewpoints(NamedTuple):
    """Where winners' cameras stand, as moving sums over batches.

    Attributes:
      rows: [3, 3] second moments of the direction of image rows, in the network's
        frame. ups: [3] sum of the image's up. elevations: [ELEVATIONS] counts.
      rolls: [ROLLS] counts.
    """

    rows: jax.Array
    ups: jax.Array
    elevations: jax.Array
    rolls: jax.Array


def start_viewpoints() -> Viewpoints:
    """Of nothing yet."""
    return Viewpoints(
        jnp.zeros((3, 3)), jnp.zeros(3), jnp.zeros(ELEVATIONS), jnp.zeros(ROLLS)
    )


def find_axis(seen: Viewpoints) -> jax.Array:
    """The unit axis [3] around which cameras stand, up."""
    _, axes = jnp.linalg.eigh(seen.rows)
    return jnp.where(jnp.dot(axes[:, 0], seen.ups) < 0, -1.0, 1.0) * axes[:, 0]


def measure_stands(poses: jax.Array, axis: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Elevation and roll, radians [n] each, of cameras with poses [n, 4]."""
    rows, up, ahead = _find_directions(poses)
    elevation = jnp.arcsin(jnp.clip(-ahead @ axis, -1, 1))
    return elevation, jnp.arctan2(rows @ axis, up @ axis)


def _find_directions(poses):
    """Image rows, image up and line of sight in the object frame; [n, 3] each."""
    back = jax.vmap(quaternion.conjugate)(poses)
    camera_axes = jnp.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]])
    found = jax.vmap(quaternion.rotate, (None, 0))(camera_axes, back)
    return found[:, 0], found[:, 1], found[:, 2]


def find_handicaps(
    candidates: jax.Array, seen: Viewpoints, weight: jax.Array
) -> jax.Array:
    """Factors [n, C], at least 1, of the costs of candidates [n, C, 4].

    1 + weight·(largest log density - log density of the candidate's stand), densities
    relative to poses that are even over SO(3).
    """
    elevation, roll = measure_stands(candidates.reshape(-1, 4), find_axis(seen))
    bins = find_bins(elevation, roll)
    by_elevation, by_roll = _find_scores(seen)
    scores = by_elevation[bins[0]] + by_roll[bins[1]]
    away = jnp.max(by_elevation) + jnp.max(by_roll) - scores
    return (1 + weight * away).reshape(candidates.shape[:2])


def find_bins(elevation: jax.Array, roll: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Bins of angles in radians; int32."""
    low = (elevation / jnp.pi + 0.5) * ELEVATIONS
    around = (roll / (2 * jnp.pi) + 0.5) * ROLLS
    return (
        jnp.clip(jnp.floor(low), 0, ELEVATIONS - 1).astype(jnp.int32),
        jnp.floor(around + 0.5).astype(jnp.int32) % ROLLS,
    )


def _find_scores(seen):
    """Log densities [ELEVATIONS] and [ROLLS] relative to even ones."""
    edges = jnp.sin(jnp.linspace(-jnp.pi / 2, jnp.pi / 2, ELEVATIONS + 1))
    even = jnp.diff(edges) / 2
    blur = jnp.array(_BLUR)
    padded = jnp.pad(seen.elevations, 1)
    by_elevation = jnp.convolve(padded, blur, mode="valid")
    area = jnp.convolve(jnp.pad(even, 1), blur, mode="valid")
    by_roll = jnp.convolve(jnp.pad(seen.rolls, 1, mode="wrap"), blur, mode="valid")
    total = jnp.maximum(jnp.sum(seen.rolls), 1)
    return (
        jnp.log(by_elevation / total / area + _PRIOR),
        jnp.log(by_roll / total * ROLLS + _PRIOR),
    )


def count_viewpoints(seen: Viewpoints, poses: jax.Array) -> Viewpoints:
    """The sums after a batch of winners [B, V, 4], of all devices."""
    poses = jax.lax.stop_gradient(poses.reshape(-1, 4))
    rows, ups, _ = _find_directions(poses)
    moments = jnp.matmul(rows.T, rows, precision="highest")
    moments, up = jax.lax.psum((moments, jnp.sum(ups, axis=0)), AXIS)
    new = seen._replace(rows=_KEPT * seen.rows + moments, ups=_KEPT * seen.ups + up)
    by_elevation, by_roll = find_bins(*measure_stands(poses, find_axis(new)))
    counts = (
        jnp.zeros(ELEVATIONS).at[by_elevation].add(1.0),
        jnp.zeros(ROLLS).at[by_roll].add(1.0),
    )
    elevations, rolls = jax.lax.psum(counts, AXIS)
    return new._replace(
        elevations=_KEPT * seen.elevations + elevations,
        rolls=_KEPT * seen.rolls + rolls,
    )
