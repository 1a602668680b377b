"""Random draws: every function over all float32 numbers, and what must hold of it."""

import functools
from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax import render
from dpc_jax.learning import losses
from dpc_jax.measure.stability.functions import SHAPE
from dpc_jax.measure.stability.images import CELLS, render_cells, render_cloud
from dpc_jax.measure.stability.runner import QUICKLY, Row
from dpc_jax.render import VoxelGrid, quaternion

DRAWS, QUICK_DRAWS = 10_000, 100
AT_ONCE = 500  # draws
LARGEST = float(np.finfo(np.float32).max)
EPSILON = float(np.finfo(np.float32).eps)
_SMALLEST = 1e-45  # above zero, subnormal


class Range(NamedTuple):
    """Float32 arrays that are drawn for one input."""

    shape: tuple[int, ...]
    low: float = -LARGEST  # bounds; by default all finite numbers, subnormal ones too
    high: float = LARGEST
    # Bounds of the ordinary numbers that are mixed in; without them, every point would
    # be out of sight.
    usual: tuple[float, float] = (-0.5, 0.5)
    smallest: float = 0.0  # smaller magnitudes become zero

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """[count, *shape]: ordinary numbers alone, or extreme ones among them."""
        size = (count, *self.shape)
        ordinary = rng.uniform(*self.usual, size)
        top = max(abs(self.low), abs(self.high))
        extreme = np.exp(rng.uniform(np.log(_SMALLEST), np.log(top), size))
        if self.low < 0:
            extreme *= rng.choice((-1, 1), size)
        special = rng.choice((self.low, self.high, 0, 1, -1, *self.usual), size)
        kinds = rng.choice(3, size, p=(0.6, 0.25, 0.15))
        kinds = np.where(rng.uniform(size=count) < 0.3, 0, kinds.T).T
        numbers = np.choose(kinds, (ordinary, extreme, special))
        numbers = np.clip(numbers, self.low, self.high).astype(np.float32)
        return np.where(np.abs(numbers) < self.smallest, np.float32(0), numbers)


class Target(NamedTuple):
    """A function, and what must hold for every draw."""

    name: str  # as a user writes it
    function: Callable  # maps the inputs as arrays to an array or a tree of arrays
    inputs: tuple[Range, ...]  # their ranges
    low: float = -np.inf  # bounds of the first of the outputs
    high: float = np.inf


def run(target: Target, *, quick: bool = True) -> Row:
    """The row of a target, which fails if a draw broke it."""
    rng, draws = np.random.default_rng(0), QUICK_DRAWS if quick else DRAWS
    drawn = [wanted.draw(rng, draws) for wanted in target.inputs]
    check = functools.partial(_check, target)
    many = functools.partial(jax.lax.map, check, batch_size=min(AT_ONCE, draws))
    options = QUICKLY if quick else None
    held = jax.device_get(jax.jit(many, compiler_options=options)(drawn))
    found = ""
    if broken := [name for name, each in held.items() if not np.all(each)]:
        first = int(np.argmin(held[broken[0]]))
        shown = "; ".join(str(a[first].tolist()) for a in drawn)
        found = f"{', '.join(broken)} did not hold for {shown}"
    return Row("random", target.name, "float32", found=found)


def _check(target, arrays) -> Mapping[str, jax.Array]:
    """Whether outputs and gradients of Σ ±output are finite, the first in bounds."""
    outputs, pull_back = jax.vjp(target.function, *arrays)
    found = {"finite": _are_finite(outputs)}
    for place, gradient in enumerate(pull_back(jax.tree.map(_alternate, outputs))):
        found[f"gradient of input {place}"] = _are_finite(gradient)
    first = jax.tree.leaves(outputs)[0]
    found["its bounds"] = jnp.all((first >= target.low) & (first <= target.high))
    return found


def _are_finite(tree):
    leaves = jax.tree.leaves(tree)
    return jnp.all(jnp.array([jnp.all(jnp.isfinite(leaf)) for leaf in leaves]))


def _alternate(output):
    """Cotangents 1, -1, 1, ...: no cell's gradient can hide behind another's."""
    size = output.size
    return (1 - 2 * (jnp.arange(size) % 2)).reshape(output.shape).astype(output.dtype)


# Functions as they are drawn for.


def _project(points, rotation, sizes, *scene, method, projection, ray_rule):
    """Of the covariances two as they were drawn, others positive semidefinite."""
    if sizes.ndim == 3:
        squares = jnp.einsum("nij,nkj->nik", sizes, sizes)
        sizes = jnp.concatenate([sizes[:2], squares[2:]])
    looks = {"method": method, "projection": projection, "ray_rule": ray_rule}
    return render_cloud(points, rotation, sizes, *scene, **looks)


def _voxelize(points, rotation, sigma, scale):
    grid = VoxelGrid(SHAPE)
    return render.voxelize(points, rotation, sigma=sigma, scale=scale, grid=grid)


def _from_axis_angle(q, angle):
    """With an axis that q turns."""
    axis = jnp.squeeze(quaternion.rotate(jnp.eye(1, 3), q))
    return quaternion.from_axis_angle(axis, angle)


# A gradient must be a float32, and of `project` it is a product of masses, colours,
# distances, focal length and 1/|q|. A translation above 1e30 that brings a point of
# 3e38 back into view would give q a gradient beyond that.
_POINTS, _SIGMA = Range((5, 3)), Range((), 0, LARGEST, (0, 4))
_SIGMAS, _SCALE = Range((5,), 0, LARGEST, (0, 4)), Range((5,), 0, 1e6, (0, 2))
_TURN = Range((4,), smallest=1e-6, usual=(-1, 1))
_STEEP_TURN = Range((4,), smallest=1e-30, usual=(-1, 1))
_CAMERA = (
    Range((3,), -1e30, 1e30),  # translation
    Range((), 1e-6, 1e6, (1, 2)),  # focal length
    Range((), -1e6, 1e6, (0.5, 3)),  # distance
    Range((), -1e6, 1e6, (0, 10)),  # depth of the background
    Range((2,), -1e6, 1e6, (0, 1)),  # colour of the background
)
_SCENE = (_SCALE, Range((5, 2), -1e6, 1e6, (0, 1)), *_CAMERA)
_CELLS = (Range(CELLS, -1e6, 1e6, (0, 1)), Range((*CELLS, 2), -1e6, 1e6, (0, 1)))
_COVARIANCES = Range((5, 3, 3), -1e3, 1e3, (-1, 1))
_SPLATS = (Range((5, 3), usual=(-1, 6)), Range((5,), -1e37, 1e37))  # a cell's sum
_PEAKS = (Range((7,), -1e6, 1e6), Range((7,), 0, 1e10, (0, 3)))  # the mass grows as σ³
_RAYS = (Range((3, 7), 0, 1, (0, 1)),)
_ROTATED = (Range((5, 3), -1e30, 1e30), Range((4,), smallest=1e-6))
# Values that are squared or multiplied.
_FACTORS = (Range((4,), -1e18, 1e18, (-1, 1)),) * 2
_IMAGES, _ANY = (Range((4, 5), -1e18, 1e18, (0, 1)),) * 2, (Range((5, 3), -1e18, 1e18),)
_PERSPECTIVE = {"projection": "perspective", "ray_rule": "termination"}
_FLAT = {"projection": "orthographic", "ray_rule": "maximum"}


def _project_target(method, rules, sizes) -> Target:
    inputs = (_POINTS, _TURN, sizes, *_SCENE)
    function = functools.partial(_project, method=method, **rules)
    name = ", ".join((f"project: {method}", *rules.values(), f"{sizes.shape} sizes"))
    return Target(name, function, inputs, 0, 1)


_UNIT = 1 + 16 * EPSILON  # the parts of unit quaternions and orthogonal matrices
_HALF_TURN = float(np.float32(np.pi)) * (1 + EPSILON)
# fmt: off
TARGETS = (
    _project_target("trilinear", _PERSPECTIVE, _SIGMA),
    _project_target("trilinear", _FLAT, _SIGMA),
    _project_target("quadratic", _PERSPECTIVE, _SIGMA),
    _project_target("gaussian", _PERSPECTIVE, _SIGMA),
    _project_target("gaussian", _PERSPECTIVE, _SIGMAS),
    _project_target("gaussian", _PERSPECTIVE, _COVARIANCES),
    *(Target(f"project_volume: {rules['projection']}",
             functools.partial(render_cells, **rules), (*_CELLS, _TURN, *_CAMERA), 0, 1)
      for rules in (_PERSPECTIVE, _FLAT)),
    Target("voxelize", _voxelize, (_POINTS, _TURN, _SIGMAS, _SCALE), 0, 1),
    Target("splat", functools.partial(render.splat, shape=SHAPE), _SPLATS),
    Target("smooth", render.smooth, (Range(SHAPE, -1e30, 1e30, (0, 1)), _SIGMA)),
    Target("mass_of_peak", render.mass_of_peak, _PEAKS),
    Target("opacity", render.opacity, _RAYS, 0, 1),
    Target("termination_probabilities", render.termination_probabilities, _RAYS, 0, 1),
    Target("quaternion.normalize", quaternion.normalize, (_STEEP_TURN,), -_UNIT, _UNIT),
    Target("quaternion.multiply", quaternion.multiply, _FACTORS),
    Target("quaternion.to_matrix", quaternion.to_matrix, (_STEEP_TURN,), -_UNIT, _UNIT),
    Target("quaternion.from_matrix", quaternion.from_matrix,
           (Range((3, 3), -1e37, 1e37),), -_UNIT, _UNIT),
    Target("quaternion.rotate", quaternion.rotate, _ROTATED),
    Target("quaternion.angle_between", quaternion.angle_between, (_STEEP_TURN,) * 2,
           0, _HALF_TURN),
    Target("quaternion.from_axis_angle", _from_axis_angle, (_STEEP_TURN, Range(())),
           -_UNIT, _UNIT),
    Target("reprojection_loss", losses.reprojection_loss, _IMAGES, 0),
    Target("student_loss", losses.student_loss, (_STEEP_TURN,) * 2, -4 * EPSILON, 1),
    Target("repulsion_energy", losses.repulsion_energy, _ANY, 0),
    Target("containment_loss", losses.containment_loss, _ANY, 0),
)
# fmt: on
