"""Losses: reprojection (Eq. 1), the student's (§ distilled ensemble), priors."""

import functools
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

from dpc_jax.render import Camera, checks, quaternion
from dpc_jax.render.camera import to_camera_frame

_RADIUS = 0.5  # of the sphere that an object of box diagonal 1 lies in
# Distance below which the energy of a pair levels off, so that coincident points have
# a finite one.
_SOFTENING = 0.02
_NEAREST = 0.1  # to the camera, of points that are pulled, box diagonals


class Term(NamedTuple):
    """One loss: its value and its weight in the sum."""

    value: jax.Array
    weight: chex.Numeric = 1.0


def reprojection_loss(predicted: jax.Array, target: jax.Array) -> jax.Array:
    """Sum of squared differences of two images of one view, a term of Eq. 1; ().

    Returns:
      () the sum over pixels.

    Raises:
      ValueError: for images of different shapes, or not of floating point numbers.

    Example:
      >>> float(dpc_jax.reprojection_loss(jnp.ones((2, 2)), jnp.zeros((2, 2))))
      4.0
    """
    predicted = checks.check_array("predicted", predicted, (...,))
    fit = "give both images one size"
    target = checks.check_array("target", target, predicted.shape, hint=fit)
    return jnp.sum((predicted - target) ** 2)


def student_loss(
    student: jax.Array, teacher: jax.Array, *, form: str = "absolute"
) -> jax.Array:
    """Angular difference 1 - |Re(q₁q₂⁻¹)| of two quaternions [4]; in [0, 1].

    Differs from the paper's 1 - Re(q₁q₂⁻¹) in taking the absolute value, because q and
    -q are one rotation, and from the released code's 1 - Re², whose gradient vanishes
    for opposite rotations. At exactly 180°, a kink, the gradient is that towards
    +teacher. The teacher gets no gradient.

    Args:
      student, teacher: quaternions of any length but zero.
      form: "absolute" for that one; "signed" for the paper's, in [0, 2]; "squared" for
        the released code's.

    Returns:
      () the loss.

    Example:
      >>> pose = jnp.array([1.0, 0, 0, 0])
      >>> float(dpc_jax.student_loss(pose, -pose))
      0.0
    """
    teacher = jax.lax.stop_gradient(quaternion.normalize(teacher))
    cosine = jnp.sum(quaternion.normalize(student) * teacher)
    if form == "signed":
        return 1 - cosine
    if form == "squared":
        return 1 - cosine**2
    return 1 - jnp.where(cosine >= 0, cosine, -cosine)


def repulsion_energy(points: jax.Array) -> jax.Array:
    """Mean Coulomb energy 1/r of the pairs of a cloud; (). Not in the paper.

    Silhouettes cannot tell a solid from its shell. Charges in a bounded region settle
    on its surface, evenly, and the reprojection loss is what bounds them.

    Args:
      points: [N, 3], N >= 2.

    Raises:
      ValueError: for fewer points.
    """
    count = points.shape[0]
    if count < 2:
        raise ValueError(
            f"repulsion_energy needs at least two points, but it got {count}; a single "
            "one has no energy."
        )
    return _sum_energies(points)


@jax.custom_vjp
def _sum_energies(points):
    energies, _ = _repel_pairs(points)
    return _average_pairs(jnp.sum(energies), points)


def _sum_energies_forward(points):
    """The forces beside the energies: both share the distances of all pairs."""
    energies, forces = _repel_pairs(points)
    gradient = jnp.stack([-2 * jnp.sum(force, axis=1) for force in forces], axis=1)
    mean = _average_pairs(jnp.sum(energies), points)
    return mean, _average_pairs(gradient, points)


def _sum_energies_backward(gradient, cotangent):
    return (gradient * cotangent,)


_sum_energies.defvjp(_sum_energies_forward, _sum_energies_backward)


def _average_pairs(total, points):
    return total / (points.shape[0] * (points.shape[0] - 1))


def _repel_pairs(points):
    """Energies [N, N] of pairs, and their forces on the first point by coordinate."""
    # An eighth of each distance: the distance between points near the two ends of the
    # float range would itself overflow.
    eighths, softening = points.T / 8, jnp.asarray(_SOFTENING, points.dtype) / 8
    away = [axis[:, None] - axis[None] for axis in eighths]
    # In units of each distance: then no square overflows, and the cube of a distance
    # in the derivative does not underflow.
    unit = functools.reduce(jnp.maximum, map(jnp.abs, away), softening)
    # The inverse of a larger unit could be subnormal, which processors flush to zero.
    inverse = 1 / jnp.minimum(unit, jnp.finfo(points.dtype).max / 16)
    away = [axis * inverse for axis in away]
    root = jax.lax.rsqrt(sum(axis * axis for axis in away) + (softening * inverse) ** 2)
    # The energy of a point with itself, 1/softening, is left out of the sum and not
    # subtracted from it: that would lose the small energies of distant points.
    is_pair = ~jnp.eye(points.shape[0], dtype=bool)
    energies = jnp.where(is_pair, root * inverse / 8, 0)
    slope = energies * (root * root * inverse) / 8
    return energies, [slope * axis for axis in away]


def containment_loss(points: jax.Array) -> jax.Array:
    """Squared distance of points [N, 3] beyond a sphere, summed; (). Not in the paper.

    An object of box diagonal 1 lies within radius 1/2. A point that has left the image
    of every view gets no other gradient and would stay where it is for good.
    """
    square = jnp.sum(points**2, axis=-1)
    is_beyond = square > _RADIUS**2
    length = jnp.sqrt(jnp.where(is_beyond, square, 1))
    return jnp.sum(jnp.where(is_beyond, (length - _RADIUS) ** 2, 0))


def measure_outside(silhouette: jax.Array) -> jax.Array:
    """Distance of each pixel from the nearest one that is covered by half or more.

    The exact Euclidean distance [D, D] of a silhouette [D, D], in widths of the image,
    one axis after the other; 0 where it is covered. Where nothing is covered it is that
    to the far end of an image twice as large, everywhere.
    """
    side = silhouette.shape[-1]
    steps = jnp.arange(side)
    squares = ((steps[:, None] - steps[None]) ** 2).astype(silhouette.dtype)
    # Half a pixel is 0.5, or by another order of divisions just less.
    far = jnp.where(silhouette > 0.5 - 1e-4, 0, 2.0 * side**2)
    by_rows = jnp.min(far[None] + squares[:, :, None], axis=1)
    both = jnp.min(by_rows[:, None] + squares[None], axis=2)
    return jnp.sqrt(jnp.minimum(both, 2.0 * side**2)) / side


def pull_inside(
    points: jax.Array,
    rotation: jax.Array,
    outside: jax.Array,
    *,
    camera: Camera,
    translation: jax.Array | None = None,
) -> jax.Array:
    """Mean distance of projected points [N, 3] from a silhouette, in image widths; ().

    Not in the paper. A point alone in an empty part of an image has next to no gradient
    from the squares of silhouettes: wherever it moves, the image around it stays as
    blank. So it hangs there; this distance tells it where to go. Of points beside the
    image it is the border's, and the way there along both axes; those behind the camera
    or just before it are told nothing.

    Args:
      outside: [D, D] of `measure_outside`. rotation, camera, translation: see
        `project`.
    """
    side = outside.shape[-1]
    moved = to_camera_frame(points, rotation, translation)
    ahead = camera.find_depths(moved)
    is_seen = ahead > _NEAREST
    plane = moved[:, :2]
    if camera.projection == "perspective":
        zoom = camera.focal_length / jnp.where(is_seen, ahead, 1)
        plane = plane * zoom[:, None]
    if camera.aspect is not None:
        plane = plane.at[:, 1].multiply(camera.aspect)
    if camera.principal_point is not None:
        plane = plane + jnp.asarray(camera.principal_point, plane.dtype)[None]
    places = (plane + 0.5) * side - 0.5  # column, row
    inside = jnp.clip(places, 0, side - 1)
    column, row = inside.T
    distances = jax.scipy.ndimage.map_coordinates(
        outside, [row, column], order=1, mode="nearest"
    )
    beside = jnp.sum(jnp.abs(places - inside), axis=1) / side
    return jnp.mean(jnp.where(is_seen, distances + beside, 0))
