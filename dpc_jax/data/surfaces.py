"""Ground truth of the evaluation: points on a surface, seen and evenly spaced.

The paper's reference has 1e5 points on each mesh, thinned to one per voxel of 0.01.
"""

import numpy as np
import trimesh

from dpc_jax.data import views
from dpc_jax.data.spec import DataSpec

VIEWPOINTS = 128  # on the viewing sphere; more of them uncover next to nothing
CLEARANCE = 1e-4  # of the box diagonal: how far before a point a hit may lie


def make_ground_truth(
    mesh: trimesh.Trimesh, spec: DataSpec, *, scene: views.Scene | None = None
) -> np.ndarray:
    """Points [P, 3] float32 that stand for the surface of a normalised mesh.

    `spec.surface_points` are spread over it; `spec.surface_voxel` keeps one per voxel.
    """
    return make_marked_truth(mesh, spec, scene=scene)[0]


def make_marked_truth(
    mesh: trimesh.Trimesh, spec: DataSpec, *, scene: views.Scene | None = None
) -> tuple[np.ndarray, np.ndarray | None]:
    """The points of `make_ground_truth`, and which of them [P] are seen from outside.

    The latter with `spec.surface_seen` alone, else None. A thinned point is seen where
    at least half of those that it stands for are.
    """
    points = views.sample_surface(mesh, count=spec.surface_points, seed=spec.seed)
    seen = None
    if spec.surface_seen:
        scene = scene or views.build_scene(mesh)
        seen = _find_visible(points, scene, distance=spec.distance)
    if spec.surface_voxel > 0:
        columns = points if seen is None else np.column_stack([points, seen])
        thinned = _thin_points(columns, voxel=spec.surface_voxel)
        points = thinned[:, :3]
        seen = None if seen is None else thinned[:, 3] >= 0.5
    return points, seen if spec.surface_seen else None


def _thin_points(points, *, voxel):
    """One point for each occupied voxel: the mean of the points in it, [P, C] float32.

    Voxels are cubes of side `voxel` with a corner at the origin. The result is in the
    order of the voxels; the order of the points changes it by rounding only. Columns of
    points [N, C] beyond the third are averaged too.
    """
    points = np.asarray(points, dtype=np.float64)
    cells = np.floor(points[:, :3] / voxel).astype(np.int64)
    cells -= cells.min(axis=0)
    wide = cells.max(axis=0) + 1
    keys = (cells[:, 0] * wide[1] + cells[:, 1]) * wide[2] + cells[:, 2]
    _, voxels, counts = np.unique(keys, return_inverse=True, return_counts=True)
    sums = [np.bincount(voxels, weights=column) for column in points.T]
    return (np.stack(sums, axis=1) / counts[:, None]).astype(np.float32)


def _find_visible(points, scene, *, distance):
    """Which points [N] a straight line reaches from some place of the viewing sphere.

    The sphere is around the origin with radius `distance`, beyond the mesh. What can be
    seen only from inside an object, such as the seats of a closed car, is left out.
    """
    points = np.asarray(points, dtype=np.float32)
    seen = np.zeros(len(points), dtype=bool)
    for eye in distance * _spread_directions(VIEWPOINTS):
        left = np.flatnonzero(~seen)  # most points are seen by the first few
        if len(left) == 0:
            break
        directions = points[left] - eye.astype(np.float32)
        origins = np.empty_like(directions)
        origins[:] = eye
        # directions end at the points: only what lies before t = 1 can hide them
        before = 1.0 - CLEARANCE / np.linalg.norm(directions, axis=1)
        blocked = scene.embree.run(
            origins, directions, dists=before.astype(np.float32), query="OCCLUDED"
        )
        seen[left] = blocked == -1
    return seen


def _spread_directions(count):
    """Unit vectors [count, 3], spread evenly over the sphere (Fibonacci spiral).

    They are shuffled, so that even the first few look from all around.
    """
    place = np.arange(count) + 0.5
    height = 1.0 - 2.0 * place / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * place
    flat = np.sqrt(1.0 - height**2)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    return directions[np.random.default_rng(0).permutation(count)]
