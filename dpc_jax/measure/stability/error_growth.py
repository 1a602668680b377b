"""How float32's error grows with the length of a sum: points, cells, rays."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.render import (
    VoxelGrid,
    opacity,
    project,
    smooth,
    termination_probabilities,
)

# Rounding errors of n terms that know nothing of each other add up as √n.
EXPECTED = 0.5
# An exponent from a few sizes and seeds is itself uncertain: of eight seeds a number's
# root mean square scatters by 1/√16, and the slope through four sizes a decade apart by
# 0.05 (one standard deviation). This is twice that.
SLACK = 0.1
_SIDE = 16  # of the volume that many points are summed in


class Curve(NamedTuple):
    """The error of one quantity over n.

    Attributes:
      subject: what n counts.
      quantity: what is computed.
      sizes: n, how many terms are summed.
      errors: root mean square over seeds of ‖a - b‖/‖b‖, float32 against float64.
      exponent: of the power of n that fits the errors best.
    """

    subject: str
    quantity: str
    sizes: tuple[int, ...]
    errors: tuple[float, ...]
    exponent: float

    @property
    def passes(self) -> bool:
        """Whether the error grows no faster than √n, within the slack."""
        return self.exponent <= EXPECTED + SLACK


def fit_exponent(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """Slope of log(error) over log(n) by least squares; infinite for a wrong error."""
    errors = np.asarray(errors, float)
    if not (np.all(np.isfinite(errors)) and np.all(errors > 0)):
        return float("inf")
    return float(np.polyfit(np.log(np.asarray(sizes, float)), np.log(errors), 1)[0])


def measure_points(
    sizes: Sequence[int], *, methods: Sequence[str], seeds: int
) -> list[Curve]:
    """Densities, and gradients that are sums over all points.

    A fixed mass, enough to fill an ellipsoid to a half, is shared by n points. No
    symmetry makes the rotation's gradient vanish.
    """

    def make_call(method, num_points):
        grid = VoxelGrid(_SIDE)

        def render(scale, rotation, points):
            image = project(
                points,
                rotation,
                sigma=1.0,
                scale=scale / num_points,
                grid=grid,
                method=method,
            )
            return image.silhouette

        def call(points, weights):
            total, rotation = (
                jnp.asarray(160, points.dtype),
                jnp.array([0.8, 0.4, 0, 0.4]),
            )
            image, pull_back = jax.vjp(
                lambda s, r: render(s, r, points), total, rotation.astype(points.dtype)
            )
            by_scale, by_rotation = pull_back(weights)
            return {
                "silhouette": image,
                "gradient of the scale": by_scale,
                "gradient of the rotation": by_rotation,
            }

        return call

    def draw(rng, num_points):
        directions = rng.normal(size=(num_points, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        points = directions * rng.uniform(0, 1, (num_points, 1)) ** (1 / 3)
        return points * (0.42, 0.28, 0.16), rng.uniform(0, 1, (_SIDE, _SIDE))

    return [
        curve
        for method in methods
        for curve in _measure(
            "points",
            sizes,
            lambda n, method=method: make_call(method, n),
            draw,
            seeds,
            suffix=f", {method}",
        )
    ]


def measure_cells(sides: Sequence[int], *, seeds: int) -> list[Curve]:
    """Smoothing a cube of cells with a kernel that grows with it.

    A smoothed cell is a sum along each axis, so n is the side; the gradient of sigma is
    one over all cells, so n is their number.
    """

    def make_call(side):
        def call(volume, weights):
            smoothed, pull_back = jax.vjp(
                smooth, volume, jnp.asarray(side / 8, volume.dtype)
            )
            by_volume, by_sigma = pull_back(weights)
            del by_volume  # the transpose is smoothing again
            return {"smoothed volume": smoothed, "gradient of sigma": by_sigma}

        return call

    def draw(rng, side):
        return rng.uniform(0, 1, (side,) * 3), rng.uniform(0, 1, (side,) * 3)

    # In the order of their names, as a tree's leaves are.
    by_sigma, smoothed = _measure("cells along a side", sides, make_call, draw, seeds)
    sizes = tuple(side**3 for side in sides)
    exponent = fit_exponent(sizes, by_sigma.errors)
    return [
        smoothed,
        by_sigma._replace(subject="cells of a volume", sizes=sizes, exponent=exponent),
    ]


def measure_images(sizes: Sequence[int], *, seeds: int) -> list[Curve]:
    """The loss of an image of n pixels."""

    def make_call(num_pixels):
        del num_pixels
        return lambda first, second: {"loss": reprojection_loss(first, second)}

    def draw(rng, num_pixels):
        return rng.uniform(0, 1, num_pixels), rng.uniform(0, 1, num_pixels)

    return _measure("pixels", sizes, make_call, draw, seeds)


def measure_rays(sizes: Sequence[int], *, seeds: int, rays: int = 64) -> list[Curve]:
    """Rays of n cells; the mean number of cells that a ray ends in stays at two."""

    def make_call(length):
        del length

        def call(occupancy, weights):
            shown, pull_back = jax.vjp(opacity, occupancy)
            (by_opacity,) = pull_back(weights[:, 0])
            ended, pull_back = jax.vjp(termination_probabilities, occupancy)
            (by_ends,) = pull_back((weights, weights[:, 0]))
            return {
                "opacity": shown,
                "opacity's gradient": by_opacity,
                "termination probabilities": ended[0],
                "background": ended[1],
                "their gradient": by_ends,
            }

        return call

    def draw(rng, length):
        return rng.uniform(0, 4 / length, (rays, length)), rng.uniform(
            0, 1, (rays, length)
        )

    return _measure("cells along a ray", sizes, make_call, draw, seeds)


def _measure(
    subject: str,
    sizes: Sequence[int],
    make_call: Callable,
    draw: Callable,
    seeds: int,
    suffix: str = "",
) -> list[Curve]:
    """Curves of all that a call gives by name."""
    squares: dict[str, list[float]] = {}
    for size in sizes:
        inputs = [
            [
                a.astype(np.float32).astype(np.float64)
                for a in draw(np.random.default_rng((seed, size)), size)
            ]
            for seed in range(seeds)
        ]
        single, double = (
            _run(make_call(size), inputs, dtype) for dtype in ("float32", "float64")
        )
        for name in double[0]:
            ratios = [
                np.sum((np.asarray(a[name], float) - b[name]) ** 2)
                / np.sum(np.asarray(b[name]) ** 2)
                for a, b in zip(single, double, strict=True)
            ]
            squares.setdefault(name, []).append(float(np.mean(ratios)))
    curves = []
    for name, values in squares.items():
        errors = tuple(float(np.sqrt(v)) for v in values)
        exponent = fit_exponent(sizes, errors)
        curves.append(Curve(subject, name + suffix, tuple(sizes), errors, exponent))
    return curves


def _run(call, inputs, dtype):
    with jax.enable_x64(dtype == "float64"):
        call = jax.jit(call)
        return [
            jax.device_get(call(*(jnp.asarray(a, dtype) for a in arrays)))
            for arrays in inputs
        ]
