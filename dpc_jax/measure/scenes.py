"""Fixed scenes, made in code: clouds that are easy and hard for a volume."""

import functools
from typing import NamedTuple

import numpy as np
import trimesh

from dpc_jax.data import views
from dpc_jax.shapes import procedural
from dpc_jax.shapes.normalization import normalize


class Scene(NamedTuple):
    """A cloud and two poses, one to render and one to make the target from."""

    name: str
    points: np.ndarray  # [N, 3] float64, in a ball of diameter 1
    mass: float  # of a point, in voxels of a 64³ grid
    pose: np.ndarray  # [4] quaternion
    target_pose: np.ndarray  # [4], some degrees away


def make_scenes(*, num_points: int, num_sparse: int, seed: int) -> list[Scene]:
    """A car's surface, a thin-legged chair, a solid block and a sparse cloud.

    Masses make the middle of the first three nearly opaque (an optical depth of about
    4 on 64² pixels) and a lone point of the last clearly visible.
    """
    sample = functools.partial(views.sample_surface, count=num_points, seed=seed)
    rng = np.random.default_rng(seed)
    car = procedural.make_shape("car_simple", seed)
    block = rng.uniform(-0.5, 0.5, (num_points, 3)) * (0.6, 0.4, 0.3)
    clouds = (
        ("car", sample(car)[0], 4000 / num_points),
        ("chair", sample(_make_chair())[0], 3000 / num_points),
        ("block", block, 5000 / num_points),
        ("sparse", draw_ball(rng, num_sparse, radius=0.45), 3.0),
    )
    pose = np.array([0.62, 0.71, 0.21, 0.26])
    target = pose + np.array([0.0, 0.12, -0.17, 0.14])  # about 28 degrees away
    return [
        Scene(
            name,
            # In a random order, so that the first n are a fair sample of all.
            rng.permutation(np.asarray(points, np.float64)),
            mass,
            pose / np.linalg.norm(pose),
            target / np.linalg.norm(target),
        )
        for name, points, mass in clouds
    ]


def draw_ball(
    rng: np.random.Generator, count: int, *, radius: float = 1.0
) -> np.ndarray:
    """Points [count, 3], evenly in a ball."""
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return radius * directions * rng.uniform(0, 1, (count, 1)) ** (1 / 3)


def _make_chair() -> trimesh.Trimesh:
    """Seat and back as thin plates; legs as thin as a fiftieth of the chair."""
    boxes = [
        ((0.02, 0.02, 0.45), (x, y, 0.225)) for x in (-0.2, 0.2) for y in (-0.2, 0.2)
    ]
    boxes += [
        ((0.44, 0.44, 0.03), (0, 0, 0.465)),
        ((0.02, 0.44, 0.45), (-0.21, 0, 0.7)),
    ]
    meshes = [
        trimesh.creation.box(size, trimesh.transformations.translation_matrix(middle))
        for size, middle in boxes
    ]
    chair = trimesh.util.concatenate(meshes)
    assert isinstance(chair, trimesh.Trimesh)  # other geometry gives other classes
    return normalize(chair)
