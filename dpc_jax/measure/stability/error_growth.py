"""How float32's error grows with the length of a sum: points, cells, rays."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax import render
from dpc_jax.learning.losses import reprojection_loss

# Independent rounding errors of n terms add up as √n.
EXPECTED = 0.5
# An exponent from a few sizes and seeds is itself uncertain: of eight seeds a number's
# root mean square scatters by 1/√16, and the slope through four sizes a decade apart by
# 0.05 (one standard deviation). This is twice that.
SLACK = 0.1
_SIDE = 16  # of the volume that many points are summed in
_RAYS = 64


class Curve(NamedTuple):
    """The error of one quantity over n."""

    subject: str  # what n counts
    quantity: str  # what is computed
    sizes: tuple[int, ...]  # n, the numbers of terms in the sum
    # Root mean square over seeds of ‖a - b‖/‖b‖, a in float32, b in float64
    errors: tuple[float, ...]
    exponent: float  # of the power of n that fits the errors best

    @property
    def passes(self) -> bool:
        """Whether the error grows no faster than √n, within the slack."""
        return self.exponent <= EXPECTED + SLACK


def fit_exponent(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """Slope of log(error) over log(n) by least squares; infinite for a wrong error."""
    found = np.asarray(errors, float)
    if not (np.all(np.isfinite(found)) and np.all(found > 0)):
        return float("inf")
    return float(np.polyfit(np.log(np.asarray(sizes, float)), np.log(found), 1)[0])


def measure_points(sizes: Sequence[int], *, seeds: int) -> list[Curve]:
    """Densities, and gradients that are sums over all points.

    A fixed mass, enough to fill an ellipsoid to a half, is shared by n points. The
    ellipsoid is turned, so that no symmetry makes the rotation's gradient vanish.
    """

    def draw(rng, num_points):
        directions = rng.normal(size=(num_points, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        points = directions * rng.uniform(0, 1, (num_points, 1)) ** (1 / 3)
        return points * (0.42, 0.28, 0.16), rng.uniform(0, 1, (_SIDE, _SIDE))

    curves = []
    for method in ("trilinear", "gaussian"):
        call = functools.partial(_render_points, method=method)
        curves += [
            curve._replace(quantity=f"{curve.quantity}, {method}")
            for curve in _measure("points", sizes, call, draw, seeds)
        ]
    return curves


def _render_points(points, weights, *, method):
    look = {"sigma": 1.0, "grid": render.VoxelGrid(_SIDE), "method": method}

    def show(scale, rotation):
        share = scale / len(points)
        return render.project(points, rotation, scale=share, **look).silhouette

    total = jnp.asarray(160, points.dtype)
    rotation = jnp.array([0.8, 0.4, 0, 0.4], points.dtype)
    image, pull_back = jax.vjp(show, total, rotation)
    by_scale, by_rotation = pull_back(weights)
    return {
        "silhouette": image,
        "gradient of the scale": by_scale,
        "gradient of the rotation": by_rotation,
    }


def measure_cells(sides: Sequence[int], *, seeds: int) -> list[Curve]:
    """Smoothing a cube of cells with a kernel that grows with it.

    A smoothed cell is a sum along each axis, so n is the side. The gradient of sigma is
    a sum over all cells, so n is their number.
    """

    def call(volume, weights):
        sigma = jnp.asarray(len(volume) / 8, volume.dtype)
        smoothed, pull_back = jax.vjp(lambda s: render.smooth(volume, s), sigma)
        (by_sigma,) = pull_back(weights)
        return {"smoothed volume": smoothed, "gradient of sigma": by_sigma}

    def draw(rng, side):
        return rng.uniform(0, 1, (2, side, side, side))

    # By name, as the leaves of a tree are ordered.
    by_sigma, smoothed = _measure("cells along a side", sides, call, draw, seeds)
    sizes = tuple(side**3 for side in sides)
    exponent = fit_exponent(sizes, by_sigma.errors)
    return [
        smoothed,
        by_sigma._replace(subject="cells of a volume", sizes=sizes, exponent=exponent),
    ]


def measure_images(sizes: Sequence[int], *, seeds: int) -> list[Curve]:
    """The loss of an image of n pixels."""

    def call(first, second):
        return {"loss": reprojection_loss(first, second)}

    def draw(rng, num_pixels):
        return rng.uniform(0, 1, (2, num_pixels))

    return _measure("pixels", sizes, call, draw, seeds)


def measure_rays(sizes: Sequence[int], *, seeds: int) -> list[Curve]:
    """Rays of n cells with a mean occupancy of 2/n, so that their sum stays at two."""

    def call(occupancy, weights):
        shown, pull_back = jax.vjp(render.opacity, occupancy)
        (by_opacity,) = pull_back(weights[:, 0])
        ended, pull_back = jax.vjp(render.termination_probabilities, occupancy)
        (by_ends,) = pull_back((weights, weights[:, 0]))
        return {
            "opacity": shown,
            "opacity's gradient": by_opacity,
            "termination probabilities": ended[0],
            "background": ended[1],
            "their gradient": by_ends,
        }

    def draw(rng, length):
        return rng.uniform(0, [[[4 / length]], [[1]]], (2, _RAYS, length))

    return _measure("cells along a ray", sizes, call, draw, seeds)


def _measure(subject, sizes, call, draw, seeds):
    """Curves of all that a call returns by name, in the order of the names."""
    errors: dict[str, list[float]] = {}
    for size in sizes:
        inputs = [
            # Numbers that float32 has too, so that both dtypes see the same.
            [np.float64(np.float32(a)) for a in draw(np.random.default_rng(key), size)]
            for key in ((seed, size) for seed in range(seeds))
        ]
        found, expected = (_run(call, inputs, dtype) for dtype in (jnp.float32, float))
        for name in expected[0]:
            ratios = [
                np.sum((np.asarray(a[name], float) - b[name]) ** 2)
                / np.sum(np.asarray(b[name]) ** 2)
                for a, b in zip(found, expected, strict=True)
            ]
            errors.setdefault(name, []).append(float(np.sqrt(np.mean(ratios))))
    return [
        Curve(subject, name, tuple(sizes), tuple(values), fit_exponent(sizes, values))
        for name, values in errors.items()
    ]


def _run(call, inputs, dtype):
    with jax.enable_x64(dtype is float):
        compiled = jax.jit(call)
        return [
            jax.device_get(compiled(*(jnp.asarray(a, dtype) for a in arrays)))
            for arrays in inputs
        ]
