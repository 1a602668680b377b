"""Random draws: every function over all float32 numbers, and what must hold of it."""

import functools
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax import render
from dpc_jax.learning import losses
from dpc_jax.measure.stability.functions import SHAPE, select
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
    # (outputs, *inputs) -> whether what the function promises holds, beside that
    # everything is finite
    holds: Callable[..., Any] = lambda outputs, *inputs: True


def run(*, quick: bool, seed: int = 0) -> Iterator[Row]:
    """A row for each target."""
    for target in TARGETS:
        yield run_target(target, quick=quick, seed=seed)


def run_target(target: Target, *, quick: bool = True, seed: int = 0) -> Row:
    """The row of a target, which fails if a draw broke it."""
    rng, draws = np.random.default_rng(seed), QUICK_DRAWS if quick else DRAWS
    drawn = [wanted.draw(rng, draws) for wanted in target.inputs]
    held = _check(target, drawn, quick)
    found = ""
    if broken := [name for name, each in held.items() if not np.all(each)]:
        first = int(np.argmin(held[broken[0]]))
        shown = "; ".join(str(a[first].tolist()) for a in drawn)
        found = f"{', '.join(broken)} did not hold for {shown}"
    return Row("random", target.name, "float32", found=found)


def _check(target, drawn, quick) -> Mapping[str, np.ndarray]:
    """Of each property whether each draw has it, by one compiled program.

    The properties are finite outputs, finite gradients of Σ ±output, and what the
    target promises.
    """

    def check(arrays):
        outputs, pull_back = jax.vjp(target.function, *arrays)
        found = {"finite": _are_finite(outputs)}
        for place, gradient in enumerate(pull_back(jax.tree.map(_alternate, outputs))):
            found[f"gradient of input {place}"] = _are_finite(gradient)
        return found | {"its promise": jnp.asarray(target.holds(outputs, *arrays))}

    batch_size = min(AT_ONCE, len(drawn[0]))
    many = functools.partial(jax.lax.map, check, batch_size=batch_size)
    options = QUICKLY if quick else None
    return jax.device_get(jax.jit(many, compiler_options=options)(drawn))


def _are_finite(tree):
    leaves = jax.tree.leaves(tree)
    return jnp.all(jnp.array([jnp.all(jnp.isfinite(leaf)) for leaf in leaves]))


def _alternate(output):
    """Cotangents 1, -1, 1, ...: no cell's gradient can hide behind another's."""
    size = output.size
    return (1 - 2 * (jnp.arange(size) % 2)).reshape(output.shape).astype(output.dtype)


# What functions promise.


def between(low: float, high: float = np.inf) -> Callable[..., Any]:
    """Whether the first of the outputs is in a range."""

    def holds(outputs, *_):
        values = jax.tree.leaves(outputs)[0]
        return jnp.all((values >= low) & (values <= high))

    return holds


_IS_SHARE, _IS_POSITIVE = between(0, 1), between(-4 * EPSILON)


def _are_probabilities(found, *_):
    cells, background = found
    errors = jnp.abs(cells.sum(-1) + background - 1)
    are_positive = jnp.all(cells >= 0) & jnp.all(background >= 0)
    return are_positive & jnp.all(errors <= 16 * EPSILON)


def _makes_no_mass(volume, coordinates, values):
    return jnp.sum(volume) <= jnp.sum(jnp.abs(values)) * (1 + 64 * EPSILON)


def _has_unit_length(q, *_):
    return jnp.abs(jnp.sum(q**2) - 1) <= 16 * EPSILON


def _is_orthogonal(matrix, *_):
    return jnp.all(jnp.abs(matrix @ matrix.T - jnp.eye(3)) <= 32 * EPSILON)


def _is_narrower(found, sigma):
    return jnp.all((found >= 0) & (found <= sigma))


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
    return Target(name, function, inputs, _IS_SHARE)


# fmt: off
TARGETS = (
    _project_target("trilinear", _PERSPECTIVE, _SIGMA),
    _project_target("trilinear", _FLAT, _SIGMA),
    _project_target("quadratic", _PERSPECTIVE, _SIGMA),
    _project_target("levels", _PERSPECTIVE, _SIGMAS),
    _project_target("gaussian", _PERSPECTIVE, _SIGMA),
    _project_target("gaussian", _PERSPECTIVE, _SIGMAS),
    _project_target("gaussian", _PERSPECTIVE, _COVARIANCES),
    *(Target(f"project_volume: {rules['projection']}",
             functools.partial(render_cells, **rules), (*_CELLS, _TURN, *_CAMERA),
             _IS_SHARE) for rules in (_PERSPECTIVE, _FLAT)),
    Target("voxelize", _voxelize, (_POINTS, _TURN, _SIGMAS, _SCALE), _IS_SHARE),
    Target("splat", functools.partial(render.splat, shape=SHAPE), _SPLATS,
           _makes_no_mass),
    Target("smooth", render.smooth, (Range(SHAPE, -1e30, 1e30, (0, 1)), _SIGMA)),
    Target("compensate_widening", render.compensate_widening,
           (Range((7,), 0, LARGEST, (0, 3)),), _is_narrower),
    Target("mass_of_peak", render.mass_of_peak, _PEAKS),
    Target("opacity", render.opacity, _RAYS, _IS_SHARE),
    Target("termination_probabilities", render.termination_probabilities, _RAYS,
           _are_probabilities),
    Target("quaternion.normalize", quaternion.normalize, (_STEEP_TURN,),
           _has_unit_length),
    Target("quaternion.multiply", quaternion.multiply, _FACTORS),
    Target("quaternion.to_matrix", quaternion.to_matrix, (_STEEP_TURN,),
           _is_orthogonal),
    Target("quaternion.from_matrix", quaternion.from_matrix,
           (Range((3, 3), -1e37, 1e37),), _has_unit_length),
    Target("quaternion.rotate", quaternion.rotate, _ROTATED),
    Target("quaternion.angle_between", quaternion.angle_between, (_STEEP_TURN,) * 2,
           between(0, float(np.float32(np.pi)) * (1 + EPSILON))),
    Target("quaternion.from_axis_angle", _from_axis_angle, (_STEEP_TURN, Range(())),
           _has_unit_length),
    Target("reprojection_loss", losses.reprojection_loss, _IMAGES, _IS_POSITIVE),
    Target("student_loss", losses.student_loss, (_STEEP_TURN,) * 2,
           between(-4 * EPSILON, 1)),
    Target("selection_loss", select, (Range((2, 3), -1e37, 1e37, (-3, 3)),),
           _IS_POSITIVE),
    Target("repulsion_energy", losses.repulsion_energy, _ANY),
    Target("containment_loss", losses.containment_loss, _ANY, _IS_POSITIVE),
)
# fmt: on
