"""What the network predicts for a batch: shapes, pose candidates, masses."""

import functools
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.config import Pose
from dpc_jax.learning import half_turns, point_sizes
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render.kernels import sample_gaussian


class Shapes(NamedTuple):
    """Predicted shapes of B objects, with the size of their points.

    Attributes:
      points: [B, N, 3], all predicted points.
      kept: [B, n, 3], those that point dropout keeps.
      colors: [B, n, 3] of the kept points, or None.
      scale: [B] in (0, 1), the learned scaling coefficient.
      mass: [B] of each point, voxels; [B, n] where sizes are learned.
      sigma: () of each point, voxels; where sizes are learned, [B, n] of each kept
        point, or the covariances [B, n, 3, 3] in voxels².
    """

    points: jax.Array
    kept: jax.Array
    colors: jax.Array | None
    scale: jax.Array
    mass: jax.Array
    sigma: jax.Array


class Cells(NamedTuple):
    """Predicted volumes of B objects, of voxel models.

    Attributes:
      cells: [B, D, D, D] occupancies in the object frame, see `project_volume`.
      colors: [B, D, D, D, 3], or None.
    """

    cells: jax.Array
    colors: jax.Array | None

    @property
    def scale(self) -> jax.Array:
        """[B], mean occupancy, which is recorded where points have their scale."""
        return jnp.mean(self.cells, axis=(1, 2, 3))


class Maps(NamedTuple):
    """Predicted maps of B objects, of EPCG.

    Attributes:
      maps: [B, 8, S, S, 3], see `ViewMapHead`.
      points: [B, N, 3], theirs in the object frame.
      logits: [B, N], above 0 of visible points.
      colors: None.
    """

    maps: jax.Array
    points: jax.Array
    logits: jax.Array
    colors: None = None

    @property
    def scale(self) -> jax.Array:
        """[B], share of visible points, recorded where points have their scale."""
        return jnp.mean(self.logits > 0, axis=1)


class Poses(NamedTuple):
    """Predicted poses of n views.

    Attributes:
      candidates: [n, C, 4] quaternions; candidate i belongs to head i % K.
      student: [n, 4], or None where there is none.
      logits: [n, C] of a student that selects a candidate, or None.
    """

    candidates: jax.Array
    student: jax.Array | None
    logits: jax.Array | None


def scale_images(images: jax.Array) -> jax.Array:
    """Bytes 0..255 to the network's [-1, 1]."""
    return images.astype(jnp.float32) / 127.5 - 1


def make_inputs(
    images: jax.Array, masks: jax.Array, *, network: ShapePoseNetwork
) -> jax.Array:
    """What the network sees of images uint8 [..., S, S, 3] with masks [..., S, S]."""
    inputs = scale_images(images)
    if not network.sees_mask:
        return inputs
    return jnp.concatenate([inputs, scale_images(masks)[..., None]], axis=-1)


def encode_views(
    params: Mapping, images: jax.Array, masks: jax.Array, *, network: ShapePoseNetwork
) -> jax.Array:
    """Features [B, V, F] of images uint8 [B, V, S, S, 3] with masks [B, V, S, S]."""
    batch_size, views = images.shape[:2]
    inputs = make_inputs(images, masks, network=network)
    flat = inputs.reshape(-1, *inputs.shape[2:])
    features = network.apply(params, flat, method="encode")
    assert isinstance(features, jax.Array)
    return features.reshape(batch_size, views, -1)


def predict_shapes(
    params: Mapping,
    features: jax.Array,
    keys: jax.Array,
    sigma: jax.Array,
    *,
    network: ShapePoseNetwork,
    kept_points: int,
    scale_unit: str,
    grid: int,
) -> Shapes | Cells | Maps:
    """The shape of each object from its features [B, F], with point dropout.

    One subset of points serves all views and candidates of an object, so that the
    choice among candidates does not depend on which points were drawn. It is drawn with
    the object's own key of keys [B]. Learned sizes take the place of sigma; they are in
    voxels of a volume of side `grid`.
    """
    shape = network.apply(params, features, method="predict_shape")
    assert isinstance(shape, dict)
    if "cells" in shape:
        return Cells(shape["cells"], shape.get("colors"))
    if "maps" in shape:
        return Maps(shape["maps"], shape["points"], shape["point_logits"])
    points, colors = shape["points"], shape.get("colors")
    size, mass = find_sizes(shape, sigma, scale_unit=scale_unit, grid=grid)
    order = jax.vmap(functools.partial(draw_order, count=points.shape[1]))(keys)
    subset = order[:, :kept_points]
    kept, colors = jax.tree.map(
        lambda a: jnp.take_along_axis(a, subset[..., None], axis=1), (points, colors)
    )
    if "sizes" in shape:
        size, mass = jax.tree.map(
            jax.vmap(lambda array, rows: array[rows]), (size, mass), (subset, subset)
        )
    return Shapes(points, kept, colors, shape["scale"], mass, size)


def find_places(shapes: Shapes | Cells) -> tuple[jax.Array, jax.Array | None]:
    """Where the matter of shapes is: places [B, n, 3], and weights [B, n] or None.

    All kept points alike, or the centres of cells by their occupancies.
    """
    if isinstance(shapes, Shapes):
        return shapes.kept, None
    sides = shapes.cells.shape[1:]
    axes = [(jnp.arange(side) + 0.5) / side - 0.5 for side in sides]
    centers = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    weights = shapes.cells.reshape(len(shapes.cells), -1)
    return jnp.broadcast_to(centers[None], (*weights.shape, 3)), weights


def find_sizes(
    shape: Mapping[str, jax.Array], sigma: jax.Array, *, scale_unit: str, grid: int
) -> tuple[jax.Array, jax.Array]:
    """(sigma, mass) in voxels of the points of B objects, as `Shapes` has them.

    Args:
      shape: of `ShapeHead`; the sizes in it take the place of sigma () of the schedule.
      grid: side of the volume, in voxels.
    """
    if "sizes" in shape:
        return point_sizes.measure_points(shape, grid=grid)
    return sigma, compute_mass(shape["scale"], sigma, scale_unit=scale_unit)


def draw_order(key: jax.Array, *, count: int) -> jax.Array:
    """The indices 0 to count - 1 in random order, [count] int32.

    One sort of single numbers: random bits above, the index below. This is several
    times faster than `jax.random.permutation`, which sorts pairs, twice. Two indices
    whose random bits agree stay in their order: of 2000, about one pair in a draw.
    """
    index_bits = max(1, (count - 1).bit_length())
    bits = jax.random.bits(key, (count,), jnp.uint32) >> index_bits << index_bits
    packed = jnp.sort(bits | jnp.arange(count, dtype=jnp.uint32))
    return (packed & (2**index_bits - 1)).astype(jnp.int32)


def predict_poses(
    params: Mapping,
    features: jax.Array,
    covariance: jax.Array,
    *,
    network: ShapePoseNetwork,
    pose: Pose,
) -> Poses:
    """Pose candidates of n views from their features [..., F].

    Args:
      covariance: [3, 3] of predicted points, whose axes the half turns are about.
    """
    features = features.reshape(-1, features.shape[-1])
    output = network.apply(params, features, method="predict_pose")
    assert isinstance(output, dict)
    return complete_poses(output, covariance, pose=pose)


def complete_poses(
    output: dict[str, jax.Array], covariance: jax.Array, *, pose: Pose
) -> Poses:
    """Add the turned candidates, and the pose of a student that selects.

    Args:
      output: of the network: candidates [n, K, 4], and student [n, 4] or logits [n, C].
      covariance: [3, 3], see `predict_poses`.
    """
    candidates, student = output["candidates"], output.get("student")
    logits = output.get("logits")
    if pose.half_turns:
        turns = half_turns.find_half_turns(covariance, pose.turns)
        turn = jax.vmap(half_turns.turn_candidates, (0, None))
        candidates = turn(candidates, turns)
    if logits is not None:
        chosen = jnp.argmax(logits, axis=-1)
        student = jnp.take_along_axis(candidates, chosen[:, None, None], axis=1)[:, 0]
    return Poses(candidates, student, logits)


def find_probabilities(poses: Poses) -> jax.Array:
    """Probabilities [n, C] of the candidates, alike where no student selects."""
    if poses.logits is None:
        return jnp.full(poses.candidates.shape[:2], 1 / poses.candidates.shape[1])
    return jax.nn.softmax(poses.logits)


def compute_mass(scale: jax.Array, sigma: jax.Array, *, scale_unit: str) -> jax.Array:
    """Mass of a point in voxels from the learned scaling coefficient in (0, 1).

    With the unit "peak" the coefficient is the peak height c_i of Eq. 3, as sampled at
    cell centres: at one, a point on a centre fills its cell, whatever its sigma. With
    "mass" it is the integral of the point's density, as in the released code.

    `mass_of_peak` is the same from a sigma of 0.7 on, to 0.1 %. It has the peak of the
    density, not of its samples: under it points would fade away while the schedule
    makes them thinner than a voxel.
    """
    if scale_unit == "mass":
        return scale
    return scale / sample_gaussian(jnp.zeros(()), sigma) ** 3
