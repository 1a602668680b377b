"""Volumes beside point clouds: one ellipsoid, whose silhouette is known in closed form.

A ray hits an ellipsoid where a quadratic has real roots; that, at many places in each
pixel, is the exact image. Cells hold the share of them that is inside, points lie at
random places inside.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.benchmark.plan import Plan
from dpc_jax.measure.timing import take_medians, time_interleaved
from dpc_jax.render import Camera, VoxelGrid, project, project_volume, quaternion

_HALF_AXES = np.array([0.38, 0.26, 0.17])
_ROTATION = np.array([0.62, 0.71, 0.21, 0.26])
_FOCAL_LENGTH, _DISTANCE = 1.875, 2.0
_CAMERA = Camera(_FOCAL_LENGTH, _DISTANCE)
_PER_CELL = 4  # places along each axis of a cell, for the share that is inside
_IMAGE_SIDE = 512  # rays along each axis of the exact image


class _Setting(NamedTuple):
    family: str  # "volume" or "points"
    label: str
    side: int  # of the grid, and of a volume
    arrays: tuple[np.ndarray, ...]  # what gets gradients beside the rotation
    render: Callable[..., Any]  # silhouette from the rotation and the arrays


def measure_solids(plan: Plan) -> list[dict[str, Any]]:
    """Error of the silhouette, run times and memory of volumes and clouds, in turns.

    The error is the mean absolute difference from the exact image, in blocks of the
    coarsest grid's pixels, over the exact image's mean.
    """
    settings = [
        *(_fill_cells(side) for side in plan.volume_sides),
        *(_draw_points(*sizes, seed=plan.seed) for sizes in plan.cloud_sizes),
    ]
    blocks = min(setting.side for setting in settings)
    exact = _average(draw_ellipse(_IMAGE_SIDE), blocks)
    calls, gradients, memory, errors = {}, {}, {}, {}
    for setting in settings:
        label = setting.label
        calls[label], gradients[label], memory[label] = _compile(setting)
        image = np.asarray(calls[label](), np.float64)
        away = np.abs(_average(image, blocks) - exact)
        errors[label] = float(np.mean(away) / np.mean(exact))
    image_seconds, gradient_seconds = (
        take_medians(time_interleaved(group, rounds=plan.rounds))
        for group in (calls, gradients)
    )
    return [
        {
            "family": setting.family,
            "setting": setting.label,
            "side": setting.side,
            "image_error": errors[setting.label],
            "image_seconds": image_seconds[setting.label],
            "gradient_seconds": gradient_seconds[setting.label],
            "temporary_bytes": memory[setting.label],
        }
        for setting in settings
    ]


def draw_ellipse(side: int) -> np.ndarray:
    """The exact silhouette, 1 where a ray hits the ellipsoid, [side, side] float64.

    With p the eye and d the ray's direction, both in axes in which the ellipsoid is
    the unit ball: (p·d)² >= d·d·(p·p - 1).
    """
    matrix = np.asarray(quaternion.to_matrix(jnp.asarray(_ROTATION)), np.float64)
    along = (np.arange(side) + 0.5) / side - 0.5
    v, u = np.meshgrid(along, along, indexing="ij")
    ray = np.stack([u / _FOCAL_LENGTH, v / _FOCAL_LENGTH, np.ones_like(u)], axis=-1)
    eye, ray = (x @ matrix / _HALF_AXES for x in (np.array([0, 0, -_DISTANCE]), ray))
    product = np.sum(ray * eye, axis=-1)
    is_hit = product**2 >= np.sum(ray * ray, axis=-1) * (np.sum(eye * eye) - 1)
    return is_hit.astype(np.float64)


def _fill_cells(side) -> _Setting:
    """The share of each cell that is inside of the ellipsoid."""
    fine = (np.arange(side * _PER_CELL) + 0.5) / (side * _PER_CELL) - 0.5
    squares = [(fine / half) ** 2 for half in _HALF_AXES]
    volume = np.zeros((side,) * 3)
    for i, first in enumerate(squares[0]):  # layer by layer, to save memory
        is_inside = first + np.add.outer(squares[1], squares[2]) < 1
        layer = is_inside.reshape(side, _PER_CELL, side, _PER_CELL).mean((1, 3))
        volume[i // _PER_CELL] += layer / _PER_CELL

    def render(rotation, cells):
        image = project_volume(cells, rotation, camera=_CAMERA, grid=VoxelGrid(side))
        return image.silhouette

    return _Setting("volume", f"volume, {side}³", side, (volume,), render)


def _draw_points(count, side, *, seed) -> _Setting:
    """Points inside, as wide as half of the space that each has, together opaque.

    Both are heuristics: the density is 1 inside on the average.
    """
    rng = np.random.default_rng([seed, count])
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = _HALF_AXES * directions * rng.uniform(0, 1, (count, 1)) ** (1 / 3)
    mass = 4 / 3 * np.pi * np.prod(_HALF_AXES) * side**3 / count
    sigma = max(0.5, 0.5 * mass ** (1 / 3))

    def render(rotation, points, mass):
        image = project(
            points,
            rotation,
            sigma=sigma,
            scale=mass,
            camera=_CAMERA,
            grid=VoxelGrid(side),
        )
        return image.silhouette

    label = f"{count} points, {side}³"
    return _Setting("points", label, side, (points, np.array(mass)), render)


def _compile(setting):
    """Calls of the image and of its gradients, and the latter's temporary memory."""

    def compute_loss(*arrays):
        return jnp.sum(setting.render(*arrays) ** 2)

    arrays = tuple(jnp.asarray(a, jnp.float32) for a in (_ROTATION, *setting.arrays))
    places = tuple(range(len(arrays)))
    image = jax.jit(setting.render)
    gradient = jax.jit(jax.grad(compute_loss, argnums=places)).lower(*arrays).compile()
    sizes = gradient.memory_analysis()  # None where the compiler does not tell
    temporary = None if sizes is None else int(sizes.temp_size_in_bytes)
    return lambda: image(*arrays), lambda: gradient(*arrays), temporary


def _average(image, blocks):
    size = len(image) // blocks
    return image.reshape(blocks, size, blocks, size).mean((1, 3))
