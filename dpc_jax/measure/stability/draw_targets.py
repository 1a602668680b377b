"""The functions that inputs are drawn for, their ranges, and what they promise."""

import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax import render
from dpc_jax.evaluation import (
    align,
    chamfer_distance,
    pose_summary,
    rotation_angle_deg,
)
from dpc_jax.learning import losses
from dpc_jax.learning.choice import hindsight
from dpc_jax.measure.stability.image_cases import (
    CELLS,
    SHAPE,
    render_cells,
    render_cloud,
)
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render import Camera, VoxelGrid, quaternion

LARGEST = float(np.finfo(np.float32).max)
EPSILON = float(np.finfo(np.float32).eps)


@dataclasses.dataclass(frozen=True)
class Range:
    """Float32 arrays that are drawn for one input."""

    shape: tuple[int, ...]  # fixed, so that a function is compiled once
    # Bounds; by default all finite numbers, also subnormal ones
    low: float = -LARGEST
    high: float = LARGEST
    # Bounds of the ordinary numbers that are mixed in; without them, every point would
    # be out of sight.
    usual: tuple[float, float] = (-0.5, 0.5)
    smallest: float = 0.0  # smaller magnitudes become zero


@dataclasses.dataclass(frozen=True)
class Target:
    """A function, and what must hold for every draw."""

    name: str  # as a user writes it
    function: Callable  # maps the inputs as arrays to an array or a tree of arrays
    inputs: tuple[Range, ...]  # their ranges
    # (outputs, *inputs) -> whether what the function promises holds, beside that
    # everything is finite
    holds: Callable[..., Any] = lambda outputs, *inputs: True
    limit: str = ""  # the documented range if it is not all finite numbers, and why
    has_gradient: bool = True  # whether every input must have a finite gradient
    # False for numpy functions, which may refuse a draw in a sentence
    is_traced: bool = True


# What functions promise.


def anything(*_):
    """For functions that promise finite numbers and no more."""
    return True


def is_share(values, *_):
    """Whether all values are in [0, 1]."""
    return jnp.all((values >= 0) & (values <= 1))


def _shows_shares(images, *_):
    return is_share(images[0])


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


def _is_angle(angle, *_):
    return (angle >= 0) & (angle <= np.float32(np.pi) * (1 + EPSILON))


def _is_degrees(angles, *_):
    return np.all((angles >= 0) & (angles <= 180))


def _is_positive(values, *_):
    return jnp.all(jnp.asarray(values) >= -4 * EPSILON)


def _is_cosine_loss(loss, *_):
    return (loss >= -4 * EPSILON) & (loss <= 1)


def _is_narrower(found, sigma):
    return jnp.all((found >= 0) & (found <= sigma))


def _is_one_of_three(index, *_):
    return (index >= 0) & (index < 3)


def _is_alignment(found, *_):
    return abs(np.linalg.norm(found[0]) - 1) <= 1e-12 and not np.any(found[-1])


# Functions as they are drawn for.


def _project(method, rules, points, rotation, sizes, *scene):
    """Of the covariances two as they were drawn, others positive semidefinite."""
    projection, rule = rules
    if sizes.ndim == 3:
        squares = jnp.einsum("nij,nkj->nik", sizes, sizes)
        sizes = jnp.concatenate([sizes[:2], squares[2:]])
    looks = {"method": method, "projection": projection, "ray_rule": rule}
    return render_cloud(points, rotation, sizes, *scene, **looks)


def _voxelize(points, rotation, sigma, scale):
    grid = VoxelGrid(SHAPE)
    return render.voxelize(points, rotation, sigma=sigma, scale=scale, grid=grid)


def _splat(coordinates, values):
    return render.splat(coordinates, values, SHAPE)


def from_axis_angle(q, angle):
    """The function of `quaternion`, with an axis that q turns."""
    axis = jnp.squeeze(quaternion.rotate(jnp.eye(1, 3), q))
    return quaternion.from_axis_angle(axis, angle)


def selection_loss(logits):
    """The loss for fixed winners."""
    return losses.selection_loss(logits, jnp.array([0, 2]))


def _choose(points, mass, candidates, target, sigma):
    options = {"sigma": sigma, "camera": Camera()}
    return hindsight.choose_candidate(points, mass, candidates, target, **options)


def _downsample(images):
    return losses.downsample_images(images.astype(jnp.uint8), 4)


@functools.cache
def _make_network():
    """A small network with its parameters at the start of training."""
    network = ShapePoseNetwork(
        num_points=6, candidates=2, channels=2, hidden=8, shape_hidden=8
    )
    images = jnp.zeros((1, 16, 16, 3))
    return network, jax.jit(network.init)(jax.random.key(0), images)


def _predict(images):
    network, params = _make_network()
    return network.apply(params, images)


def _align(*arrays):
    """What must be finite of an alignment; spread and rms are infinite far away."""
    found = align(*arrays)
    finite = (found.rotation, found.inlier_share, found.chamfer, found.icp_turn_deg)
    return *finite, np.isnan([found.spread_deg, found.rms])


_POINTS, _SIGMA = Range((5, 3)), Range((), 0, LARGEST, (0, 4))
_SIGMAS, _SCALE = Range((5,), 0, LARGEST, (0, 4)), Range((5,), 0, 1e6, (0, 2))
_ROTATION = Range((4,), smallest=1e-6, usual=(-1, 1))
_NOT_TINY = Range((4,), smallest=1e-30, usual=(-1, 1))
_CAMERA = (
    Range((3,)),  # translation
    Range((), 1e-6, 1e6, (1, 2)),  # focal length
    Range((), -1e6, 1e6, (0.5, 3)),  # distance
    Range((), -1e6, 1e6, (0, 10)),  # depth of the background
    Range((2,), -1e6, 1e6, (0, 1)),  # colour of the background
)
_SCENE = (_SCALE, Range((5, 2), -1e6, 1e6, (0, 1)), *_CAMERA)
_CELLS = Range(CELLS, -1e6, 1e6, (0, 1))
_COVARIANCES = Range((5, 3, 3), -1e3, 1e3, (-1, 1))
_PLAIN, _FLAT = ("perspective", "termination"), ("orthographic", "maximum")
_LIMIT = (
    "masses, |colours|, |distance| and |background| ≤ 1e6, focal length 1e-6 to 1e6, "
    "|q| 0 or ≥ 1e-6: a gradient is a product of all these (and of 1/|q|), and must be "
    "a float32; any points, translation and sigma ≥ 0"
)


def list_targets() -> list[Target]:
    """All functions that inputs are drawn for."""
    return [
        *_list_images(),
        *(Target(*row) for row in (*_list_volumes(), *_list_quaternions())),
        *(Target(*row) for row in _list_losses()),
        *_list_choices(),
        *(Target(*row, is_traced=False) for row in _list_scores()),
        Target(
            *("ShapePoseNetwork", _predict, (Range((1, 16, 16, 3), -1, 1, (-1, 1)),)),
            lambda found, _: jnp.all(abs(found["points"]) <= 0.5),  # the unit cube
            "images in [-1, 1], its domain",
        ),
    ]


def _list_images() -> Iterator[Target]:
    kinds = "; |covariance| ≤ 3e6, some of them indefinite, which is no covariance"
    for name, sizes, rules, limit in (
        ("trilinear", _SIGMA, _PLAIN, ""),
        ("gaussian", _SIGMA, _PLAIN, ""),
        ("gaussian, σ per point", _SIGMAS, _PLAIN, ""),
        ("gaussian, covariances", _COVARIANCES, _PLAIN, kinds),
        ("trilinear", _SIGMA, _FLAT, ""),
    ):
        draw = functools.partial(_project, name.partition(",")[0], rules)
        name = f"project: {name}, {', '.join(rules)}"
        inputs = (_POINTS, _ROTATION, sizes, *_SCENE)
        yield Target(name, draw, inputs, _shows_shares, _LIMIT + limit)
    limit = _LIMIT.replace("masses", "|occupancies|")
    for projection, rule in (_PLAIN, _FLAT):
        draw = functools.partial(render_cells, projection=projection, ray_rule=rule)
        inputs = (_CELLS, Range((*CELLS, 2), -1e6, 1e6, (0, 1)), _ROTATION, *_CAMERA)
        name = f"project_volume: {projection}, {rule}"
        yield Target(name, draw, inputs, _shows_shares, limit)


def _list_volumes() -> Iterator[tuple]:
    """Rows of fields of `Target`, as in the next functions."""
    clouds = (_POINTS, _ROTATION, _SIGMAS, _SCALE)
    yield "voxelize", _voxelize, clouds, is_share, _LIMIT
    values, places = Range((5,), -1e37, 1e37), Range((5, 3), usual=(-1, 6))
    limit = "|values| ≤ 1e37: the sum of a cell must be a float32"
    yield "splat", _splat, (places, values), _makes_no_mass, limit
    volume, limit = Range(SHAPE, -1e30, 1e30, (0, 1)), "|volume| ≤ 1e30: sigma's "
    limit += "gradient is a sum over all cells"
    yield "smooth", render.smooth, (volume, _SIGMA), anything, limit
    sigmas = (Range((7,), 0, LARGEST, (0, 3)),)
    function = render.compensate_widening
    yield "compensate_widening", function, sigmas, _is_narrower
    peaks = (Range((7,), -1e6, 1e6), Range((7,), 0, 1e10, (0, 3)))
    limit = "|peak| ≤ 1e6 and sigma ≤ 1e10: the mass grows as σ³"
    yield "mass_of_peak", render.mass_of_peak, peaks, anything, limit
    rays, limit = (Range((3, 7), 0, 1, (0, 1)),), "occupancies in [0, 1], its domain"
    yield "opacity", render.opacity, rays, is_share, limit
    function = render.termination_probabilities
    yield "termination_probabilities", function, rays, _are_probabilities, limit


def _list_quaternions() -> Iterator[tuple]:
    steep = "components 0 or ≥ 1e-30 (the gradient grows as 1/|q|)"
    large = "components ≤ 1e18: products of larger ones are not float32"
    far = "coordinates ≤ 1e30, |q| 0 or ≥ 1e-6: the gradient grows as their quotient"
    entries, turned = "entries ≤ 1e37 (a rotation has entries up to 1)", "unit axes "
    turned += "(drawn as the turned x axis), any angle"
    factor, matrix = Range((4,), -1e18, 1e18, (-1, 1)), Range((3, 3), -1e37, 1e37)
    moved = (Range((5, 3), -1e30, 1e30), Range((4,), smallest=1e-6))
    for function, inputs, holds, limit in (
        (quaternion.normalize, (_NOT_TINY,), _has_unit_length, steep),
        (quaternion.conjugate, (Range((4,), usual=(-1, 1)),), anything, ""),
        (quaternion.multiply, (factor, factor), anything, large),
        (quaternion.to_matrix, (_NOT_TINY,), _is_orthogonal, steep),
        (quaternion.from_matrix, (matrix,), _has_unit_length, entries),
        (quaternion.rotate, moved, anything, far),
        (quaternion.angle_between, (_NOT_TINY, _NOT_TINY), _is_angle, steep),
        (from_axis_angle, (_NOT_TINY, Range(())), _has_unit_length, turned),
    ):
        yield f"quaternion.{function.__name__}", function, inputs, holds, limit


def _list_losses() -> Iterator[tuple]:
    image, points = Range((4, 5), -1e18, 1e18, (0, 1)), Range((5, 3), -1e18, 1e18)
    logits = Range((2, 3), -1e37, 1e37, (-3, 3))
    steep = "components 0 or ≥ 1e-30 (the gradient grows as 1/|q|)"
    squared = "values ≤ 1e18: they are squared"
    apart = "logits ≤ 1e37: the loss is their difference"
    for function, inputs, holds, limit in (
        (losses.reprojection_loss, (image, image), _is_positive, squared),
        (losses.student_loss, (_NOT_TINY, _NOT_TINY), _is_cosine_loss, steep),
        (selection_loss, (logits,), _is_positive, apart),
        (losses.repulsion_energy, (points,), anything, squared),
        (losses.containment_loss, (points,), _is_positive, squared),
    ):
        yield function.__name__, function, inputs, holds, limit


def _list_choices() -> Iterator[Target]:
    bytes_ = Range((2, 8, 8), 0, 255, (0, 255))
    yield Target("downsample_images", _downsample, (bytes_,), is_share, "", False)
    inputs = (
        *(_POINTS, Range((), 0, LARGEST, (0, 2)), Range((3, 4), usual=(-1, 1))),
        *(Range((8, 8), 0, 1, (0, 1)), Range((), 0, LARGEST, (0, 3))),
    )
    yield Target("choose_candidate", _choose, inputs, _is_one_of_three, "", False)


def _list_scores() -> Iterator[tuple]:
    poses, clouds = Range((2, 2, 4), usual=(-1, 1)), Range((2, 5, 3))
    refused = "a zero quaternion is refused"
    yield "rotation_angle_deg", rotation_angle_deg, (poses, poses), _is_degrees, refused
    errors, limit = (Range((7,), usual=(0, 180)),), "errors outside 0° to 180° refused"
    yield "pose_summary", pose_summary, errors, lambda f, _: is_share(f.accuracy), limit
    pair = (Range((6, 3)), Range((5, 3)))
    yield "chamfer_distance", chamfer_distance, pair, _is_positive
    yield "align", _align, (poses, poses, clouds, clouds), _is_alignment, refused
