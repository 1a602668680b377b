"""Random draws for the renderer and the quaternion operations."""

import functools

import jax.numpy as jnp
import numpy as np

from dpc_jax import render
from dpc_jax.measure.stability.draws.targets import (
    LARGEST,
    Range,
    Target,
    is_share,
    promise,
)
from dpc_jax.render import quaternion

_COUNT, _SHAPE, _CHANNELS = 5, (4, 5, 6), 2
_GRID = render.VoxelGrid(_SHAPE)
_EPSILON = float(np.finfo(np.float32).eps)

_POINTS = Range((_COUNT, 3))
# The gradient to a quaternion q grows as 1/|q|.
_ROTATION = Range((4,), smallest=1e-6, usual=(-1, 1))
_SCALE = Range((_COUNT,), 0, 1e6, (0, 2))
_SIGMA, _SIGMAS = Range((), 0, LARGEST, (0, 4)), Range((_COUNT,), 0, LARGEST, (0, 4))
_SCENE = (
    _SCALE,
    Range((_COUNT, _CHANNELS), -1e6, 1e6, (0, 1)),  # colours
    Range((3,)),  # translation
    Range((), 1e-6, 1e6, (1, 2)),  # focal length
    Range((), -1e6, 1e6, (0.5, 3)),  # distance
    Range((), -1e6, 1e6, (0, 10)),  # depth of the background
    Range((_CHANNELS,), -1e6, 1e6, (0, 1)),  # colour of the background
)
_RULES = (("perspective", "termination"), ("orthographic", "maximum"))
_LIMIT = (
    "masses, |colours|, |distance| and |background| ≤ 1e6, focal length 1e-6 to 1e6, "
    "|q| 0 or ≥ 1e-6: a gradient is a product of all these (and of 1/|q|), and must be "
    "a float32; any points, translation and sigma ≥ 0"
)


def list_targets() -> list[Target]:
    """Targets of `dpc_jax.render`."""
    return [
        *_list_projections(),
        *_list_object_volumes(),
        *_list_volumes(),
        *_list_quaternions(),
    ]


def _list_projections():
    plain = ("perspective", "termination")
    kinds = "; |covariance| ≤ 3e6, some of them indefinite, which is no covariance"
    covariances = Range((_COUNT, 3, 3), -1e3, 1e3, (-1, 1))
    for name, sizes, projection, rule, limit in (
        ("trilinear", _SIGMA, *plain, ""),
        ("gaussian", _SIGMA, *plain, ""),
        ("gaussian, σ per point", _SIGMAS, *plain, ""),
        ("gaussian, covariances", covariances, *plain, kinds),
        ("trilinear", _SIGMA, "orthographic", "maximum", ""),
    ):
        yield Target(
            f"project: {name}, {projection}, {rule}",
            functools.partial(_project, name, projection, rule),
            (_POINTS, _ROTATION, sizes, *_SCENE),
            promise("silhouette in [0, 1]", lambda images: is_share(images[0])),
            _LIMIT + limit,
        )


def _project(name, projection, rule, points, rotation, sizes, *scene):
    scale, colors, translation, focal, distance, far, behind = scene
    is_covariance = name.endswith("covariances")
    if is_covariance:
        # Two as they were drawn, the others positive semidefinite up to rounding.
        squares = jnp.einsum("nij,nkj->nik", sizes, sizes)
        sizes = jnp.concatenate([sizes[:2], squares[2:]])
    images = render.project(
        points,
        rotation,
        sigma=None if is_covariance else sizes,
        covariance=sizes if is_covariance else None,
        scale=scale,
        colors=colors,
        translation=translation,
        camera=render.Camera(focal, distance, projection),
        grid=_GRID,
        signals=("silhouette", "depth", "color"),
        method=name.partition(",")[0],
        ray_rule=rule,
        background_depth=far,
        background_color=behind,
    )
    return images.silhouette, images.depth, images.color


def _list_object_volumes():
    inputs = (
        Range((2, 3, 4), -1e6, 1e6, (0, 1)),
        Range((2, 3, 4, _CHANNELS), -1e6, 1e6, (0, 1)),
        _ROTATION,
        *_SCENE[2:],
    )
    for projection, rule in _RULES:
        yield Target(
            f"project_volume: {projection}, {rule}",
            functools.partial(_project_volume, projection, rule),
            inputs,
            promise("silhouette in [0, 1]", lambda images: is_share(images[0])),
            _LIMIT.replace("masses", "|occupancies|"),
        )


def _project_volume(projection, rule, volume, colors, rotation, *scene):
    translation, focal, distance, far, behind = scene
    images = render.project_volume(
        volume,
        rotation,
        colors=colors,
        translation=translation,
        camera=render.Camera(focal, distance, projection),
        grid=_GRID,
        signals=("silhouette", "depth", "color"),
        ray_rule=rule,
        background_depth=far,
        background_color=behind,
    )
    return images.silhouette, images.depth, images.color


def _keeps_mass(volume, coordinates, values):
    total = jnp.sum(jnp.abs(values))
    return {"no mass is made": jnp.sum(volume) <= total * (1 + 64 * _EPSILON)}


def _list_volumes():
    yield Target(
        "voxelize",
        lambda points, rotation, sigma, scale: render.voxelize(
            points, rotation, sigma=sigma, scale=scale, grid=_GRID
        ),
        (_POINTS, _ROTATION, _SIGMAS, _SCALE),
        promise("occupancy in [0, 1]", is_share),
        _LIMIT,
    )
    yield Target(
        "splat",
        lambda coordinates, values: render.splat(coordinates, values, _SHAPE),
        (Range((_COUNT, 3), usual=(-1, 6)), Range((_COUNT,), -1e37, 1e37)),
        _keeps_mass,
        "|values| ≤ 1e37: the sum of a cell must be a float32",
    )
    yield Target(
        "smooth",
        render.smooth,
        (Range(_SHAPE, -1e30, 1e30, (0, 1)), _SIGMA),
        limit="|volume| ≤ 1e30: the gradient of sigma is a sum over all cells",
    )
    yield Target(
        "compensate_widening",
        render.compensate_widening,
        (Range((7,), 0, LARGEST, (0, 3)),),
        lambda found, given: {
            "between 0 and sigma": jnp.all((found >= 0) & (found <= given))
        },
    )
    yield Target(
        "mass_of_peak",
        render.mass_of_peak,
        (Range((7,), -1e6, 1e6), Range((7,), 0, 1e10, (0, 3))),
        limit="|peak| ≤ 1e6 and sigma ≤ 1e10: the mass grows as σ³",
    )
    for function, holds in (
        (render.opacity, promise("in [0, 1]", is_share)),
        (render.termination_probabilities, _are_probabilities),
    ):
        inputs = (Range((3, 7), 0, 1, (0, 1)),)
        limit = "occupancies in [0, 1], its domain"
        yield Target(function.__name__, function, inputs, holds, limit)


def _are_probabilities(found, _):
    cells, background = found
    errors = jnp.abs(cells.sum(-1) + background - 1)
    return {
        "not negative": jnp.all(cells >= 0) & jnp.all(background >= 0),
        "the sum is 1": jnp.all(errors <= 16 * _EPSILON),
    }


def _list_quaternions():
    any_length = Range((4,), usual=(-1, 1))
    not_tiny = Range((4,), smallest=1e-30, usual=(-1, 1))
    factor = Range((4,), -1e18, 1e18, (-1, 1))
    matrix = Range((3, 3), -1e37, 1e37, (-1, 1))
    moved = (Range((_COUNT, 3), -1e30, 1e30), Range((4,), smallest=1e-6))
    steep = "components 0 or ≥ 1e-30 (the gradient grows as 1/|q|)"
    large = "components ≤ 1e18: products of larger ones are not float32"
    far = "coordinates ≤ 1e30, |q| 0 or ≥ 1e-6: the gradient grows as their quotient"
    entries = "entries ≤ 1e37 (a rotation has entries up to 1)"
    for function, inputs, limit, *holds in (
        (quaternion.normalize, (not_tiny,), steep, _has_unit_length),
        (quaternion.conjugate, (any_length,), ""),
        (quaternion.multiply, (factor, factor), large),
        (quaternion.to_matrix, (not_tiny,), steep, _is_orthogonal),
        (quaternion.from_matrix, (matrix,), entries, _has_unit_length),
        (quaternion.rotate, moved, far),
        (quaternion.angle_between, (not_tiny, not_tiny), steep, _is_angle),
    ):
        name = f"quaternion.{function.__name__}"
        yield Target(name, function, inputs, *holds, limit=limit)
    yield Target(
        "quaternion.from_axis_angle",
        lambda axis, angle: quaternion.from_axis_angle(
            jnp.squeeze(quaternion.rotate(jnp.eye(1, 3), axis)), angle
        ),
        (not_tiny, Range(())),
        _has_unit_length,
        "unit axes (drawn as the turned x axis), any angle",
    )


def _has_unit_length(q, *_):
    return {"unit length": jnp.abs(jnp.sum(q**2) - 1) <= 16 * _EPSILON}


def _is_orthogonal(matrix, *_):
    error = jnp.abs(matrix @ matrix.T - jnp.eye(3))
    return {"orthogonal": jnp.all(error <= 32 * _EPSILON)}


def _is_angle(angle, *_):
    most = np.float32(np.pi) * (1 + _EPSILON)
    return {"in [0, π]": (angle >= 0) & (angle <= most)}
