"""Random draws for the renderer and the quaternion operations."""

import jax.numpy as jnp
import numpy as np

from dpc_jax import render
from dpc_jax.measure.stability.draws.targets import LARGEST, Range, Target
from dpc_jax.render import quaternion

_COUNT, _GRID, _CHANNELS = 5, render.VoxelGrid((4, 5, 6)), 2
_EPSILON = float(np.finfo(np.float32).eps)
_SIGNALS = ("silhouette", "depth", "color")

_POINTS = Range((_COUNT, 3))
# The gradient of a rotation is of the size of 1/|q|.
_ROTATION = Range((4,), smallest=1e-6, usual=(-1, 1))
_SCALE = Range((_COUNT,), 0, 1e6, (0, 2))
_COLORS = Range((_COUNT, _CHANNELS), -1e6, 1e6, (0, 1))
_FOCAL = Range((), 1e-6, 1e6, (1, 2))
_DISTANCE = Range((), -1e6, 1e6, (0.5, 3))
_BEHIND = Range((), -1e6, 1e6, (0, 10))
_SIZES = {
    "trilinear": Range((), 0, LARGEST, (0, 4)),
    "gaussian": Range((), 0, LARGEST, (0, 4)),
    "own": Range((_COUNT,), 0, LARGEST, (0, 4)),
    "covariance": Range((_COUNT, 3, 3), -1e3, 1e3, (-1, 1)),
}
_LIMIT = (
    "masses, |colours|, |distance| and |background| ≤ 1e6, focal length 1e-6 to 1e6, "
    "|q| 0 or ≥ 1e-6: a gradient is a product of all these (and of 1/|q|), and must be "
    "a float32; any points, translation and sigma ≥ 0"
)


def list_targets() -> list[Target]:
    """Targets of `dpc_jax.render`."""
    return [
        *_list_projections(),
        *_list_volumes(),
        *_list_rays(),
        *_list_sizes(),
        *_list_quaternions(),
    ]


def _list_projections():
    for size, projection, rule in (
        ("trilinear", "perspective", "termination"),
        ("gaussian", "perspective", "termination"),
        ("own", "perspective", "termination"),
        ("covariance", "perspective", "termination"),
        ("trilinear", "orthographic", "maximum"),
    ):
        words = {"own": "gaussian, σ per point", "covariance": "gaussian, covariances"}
        kinds = "; |covariance| ≤ 3e6, some of them indefinite, which is no covariance"
        yield Target(
            name=f"project: {words.get(size, size)}, {projection}, {rule}",
            function=_make_projection(size, projection, rule),
            inputs=(
                _POINTS,
                _ROTATION,
                _SIZES[size],
                _SCALE,
                _COLORS,
                Range((3,)),
                _FOCAL,
                _DISTANCE,
                _BEHIND,
                Range((_CHANNELS,), -1e6, 1e6, (0, 1)),
            ),
            holds=lambda images, *_: {"silhouette in [0, 1]": _is_share(images[0])},
            limit=_LIMIT + (kinds if size == "covariance" else ""),
        )


def _make_projection(size, projection, rule):
    def call(points, rotation, width, scale, colors, translation, focal, distance, *bg):
        is_covariance = size == "covariance"
        if is_covariance:
            # Two as they were drawn, the others positive semidefinite up to rounding.
            squares = jnp.einsum("nij,nkj->nik", width, width)
            width = jnp.concatenate([width[:2], squares[2:]])
        images = render.project(
            points,
            rotation,
            sigma=None if is_covariance else width,
            covariance=width if is_covariance else None,
            scale=scale,
            colors=colors,
            translation=translation,
            camera=render.Camera(focal, distance, projection),
            grid=_GRID,
            signals=_SIGNALS,
            method="trilinear" if size == "trilinear" else "gaussian",
            ray_rule=rule,
            background_depth=bg[0],
            background_color=bg[1],
        )
        return images.silhouette, images.depth, images.color

    return call


def _list_volumes():
    shape = _GRID.shape
    yield Target(
        name="voxelize",
        function=lambda points, rotation, sigma, scale: render.voxelize(
            points, rotation, sigma=sigma, scale=scale, grid=_GRID
        ),
        inputs=(_POINTS, _ROTATION, _SIZES["own"], _SCALE),
        holds=lambda volume, *_: {"occupancy in [0, 1]": _is_share(volume)},
        limit=_LIMIT,
    )

    def keep_mass(volume, coordinates, values):
        total = jnp.sum(jnp.abs(values))
        return {"no mass is made": jnp.sum(volume) <= total * (1 + 64 * _EPSILON)}

    yield Target(
        name="splat",
        function=lambda coordinates, values: render.splat(coordinates, values, shape),
        inputs=(Range((_COUNT, 3), usual=(-1, 6)), Range((_COUNT,), -1e37, 1e37)),
        holds=keep_mass,
        limit="|values| ≤ 1e37: the sum of a cell must be a float32",
    )
    yield Target(
        name="smooth",
        function=render.smooth,
        inputs=(Range(shape, -1e30, 1e30, (0, 1)), _SIZES["trilinear"]),
        limit="|volume| ≤ 1e30: the gradient of sigma is a sum over all cells",
    )


def _list_rays():
    occupancy = Range((3, 7), 0, 1, (0, 1))
    slack = 16 * _EPSILON
    yield Target(
        name="opacity",
        function=render.opacity,
        inputs=(occupancy,),
        holds=lambda shown, *_: {"in [0, 1]": _is_share(shown)},
        limit="occupancies in [0, 1], its domain",
    )
    yield Target(
        name="termination_probabilities",
        function=render.termination_probabilities,
        inputs=(occupancy,),
        holds=lambda found, *_: {
            "not negative": jnp.all(found[0] >= 0) & jnp.all(found[1] >= 0),
            "the sum is 1": jnp.all(jnp.abs(found[0].sum(-1) + found[1] - 1) <= slack),
        },
        limit="occupancies in [0, 1], its domain",
    )


def _list_sizes():
    sigma = Range((7,), 0, LARGEST, (0, 3))
    yield Target(
        name="compensate_widening",
        function=render.compensate_widening,
        inputs=(sigma,),
        holds=lambda found, given: {
            "between 0 and sigma": jnp.all((found >= 0) & (found <= given))
        },
    )
    yield Target(
        name="mass_of_peak",
        function=render.mass_of_peak,
        inputs=(Range((7,), -1e6, 1e6), Range((7,), 0, 1e10, (0, 3))),
        limit="|peak| ≤ 1e6 and sigma ≤ 1e10: the mass grows as σ³",
    )


def _list_quaternions():
    any_length = Range((4,), usual=(-1, 1))
    not_tiny = Range((4,), smallest=1e-30, usual=(-1, 1))
    factor = Range((4,), -1e18, 1e18, (-1, 1))
    tiny = "0 or ≥ 1e-30 (the gradient is of the size of 1/|q|)"
    yield Target(
        name="quaternion.normalize",
        function=quaternion.normalize,
        inputs=(not_tiny,),
        holds=lambda unit, _: {"unit length": _is_unit(unit)},
        limit=f"components {tiny}",
    )
    yield Target(
        name="quaternion.conjugate",
        function=quaternion.conjugate,
        inputs=(any_length,),
    )
    yield Target(
        name="quaternion.multiply",
        function=quaternion.multiply,
        inputs=(factor, factor),
        limit="components ≤ 1e18: products of larger ones are not float32",
    )
    yield Target(
        name="quaternion.to_matrix",
        function=quaternion.to_matrix,
        inputs=(not_tiny,),
        holds=lambda m, _: {
            "orthogonal": jnp.all(jnp.abs(m @ m.T - jnp.eye(3)) <= 32 * _EPSILON)
        },
        limit=f"components {tiny}",
    )
    yield Target(
        name="quaternion.from_matrix",
        function=quaternion.from_matrix,
        inputs=(Range((3, 3), -1e37, 1e37, (-1, 1)),),
        holds=lambda unit, _: {"unit length": _is_unit(unit)},
        limit="entries ≤ 1e37 (a rotation has entries up to 1)",
    )
    yield Target(
        name="quaternion.rotate",
        function=quaternion.rotate,
        inputs=(Range((_COUNT, 3), -1e30, 1e30), Range((4,), smallest=1e-6)),
        limit="coordinates ≤ 1e30, |q| 0 or ≥ 1e-6: the gradient is of the size of "
        "their quotient",
    )
    yield Target(
        name="quaternion.angle_between",
        function=quaternion.angle_between,
        inputs=(not_tiny, not_tiny),
        holds=lambda angle, *_: {
            "in [0, π]": (angle >= 0) & (angle <= np.float32(np.pi) * (1 + _EPSILON))
        },
        limit=f"components {tiny}",
    )
    yield Target(
        name="quaternion.from_axis_angle",
        function=lambda axis, angle: quaternion.from_axis_angle(
            quaternion.rotate(jnp.array([[1.0, 0, 0]]), axis)[0], angle
        ),
        inputs=(not_tiny, Range(())),
        holds=lambda unit, *_: {"unit length": _is_unit(unit)},
        limit="unit axes (drawn as the turned x axis), any angle",
    )


def _is_share(values):
    return jnp.all((values >= 0) & (values <= 1))


def _is_unit(vector):
    return jnp.abs(jnp.sum(vector**2) - 1) <= 16 * _EPSILON
