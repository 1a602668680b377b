"""From a mesh to the arrays of a model: random viewpoints, lights, ground truth.

The ground truth of the evaluation is points on the surface, evenly spaced. The paper's
reference has 1e5 points on each mesh, thinned to one per voxel of 0.01.
"""

import numpy as np
import trimesh
from scipy.spatial import KDTree

from dpc_jax.config import ELEVATIONS
from dpc_jax.data import viewpoints, views
from dpc_jax.data.arrays import VISIBLE_STEPS
from dpc_jax.data.spec import DataSpec
from dpc_jax.data.splits import FINAL, SPLITS
from dpc_jax.evaluation.chamfer import find_rows

CAMERA = ("image_size", "focal_length", "distance")
# On the viewing sphere. With 256 a chair or an airplane has 0.3 % more of its surface
# visible, a car 15 %, through gaps of its body.
VIEWPOINTS = 32
_TESTED, _NEAR = 2000, 4  # points that decide which others are tested
_LEAST_SEEN = 0.05  # share of a surface, below which few points are drawn and repeated
CLEARANCE = 1e-4  # of the box diagonal: how far before a point a hit may lie


def render_mesh(
    mesh: trimesh.Trimesh, spec: DataSpec, index: int
) -> dict[str, np.ndarray]:
    """The arrays of a normalised mesh, the index-th of its data set."""
    scene = views.build_scene(mesh)
    camera = {name: getattr(spec, name) for name in CAMERA}
    # every model has its own stream: any number of processes gives the same views
    stream = [spec.seed, (*SPLITS, FINAL).index(spec.split), index]
    rng = np.random.default_rng(stream)
    cameras = _draw_cameras(spec, stream)
    pictures = []
    for number in range(spec.views):
        own = {name: rows[number] for name, rows in cameras.items()}
        azimuth = rng.uniform(0.0, 2.0 * np.pi)
        elevation = np.deg2rad(rng.uniform(*ELEVATIONS))
        rotation = viewpoints.look_at_rotation(azimuth, elevation)
        lights = views.draw_lights(rng)
        view = views.render_view(scene, rotation, lights=lights, **(camera | own))
        pictures.append((*view, rotation))
    corners = _render_corners(scene, camera) if spec.corner_views else {}
    kept = {f"{name}s": rows.astype(np.float32) for name, rows in cameras.items()}
    points, _ = views.sample_surface(mesh, count=spec.surface_points, seed=spec.seed)
    if spec.surface_voxel:
        points = _thin_points(points, voxel=spec.surface_voxel)
    truth = {"surfaces": points}
    if spec.visible_points:
        truth["visible"] = sample_visible(mesh, scene, spec)
    return viewpoints.stack_views(pictures) | truth | kept | corners


def _render_corners(scene, camera):
    """Masks and depths from the corners of a cube, as EPCG learns from."""
    lights = views.Lights(np.zeros((0, 3)), np.zeros(0), 1.0)  # colours are not kept
    turns = [viewpoints.look_at_rotation(*np.deg2rad(a)) for a in viewpoints.CORNERS]
    seen = [views.render_view(scene, turn, lights=lights, **camera) for turn in turns]
    return {
        "corner_masks": np.stack([view.mask for view in seen]),
        "corner_depths": np.stack([view.depth for view in seen]).astype(np.float32),
    }


def _draw_cameras(spec, stream):
    """Translation and focal length of each view, where views differ in them.

    Of a stream of their own: the same objects are seen from the same sides as without.
    """
    rng = np.random.default_rng([*stream, 1])
    cameras = {}
    if spec.offset:
        low, high = -spec.offset, spec.offset
        cameras["translation"] = rng.uniform(low, high, (spec.views, 3))
    if spec.focal_spread:
        shares = rng.uniform(-spec.focal_spread, spec.focal_spread, spec.views)
        cameras["focal_length"] = spec.focal_length * (1 + shares)
    return cameras


def sample_visible(
    mesh: trimesh.Trimesh, scene: views.Scene, spec: DataSpec
) -> np.ndarray:
    """`spec.visible_points` points uint16 [P, 3] of what is visible of a mesh.

    They are uniform by area, in the unit of `DataSet.read_visible`; of the whole
    surface where none of it can be seen. Few points are tested first, and of the others
    only those that have a visible one among the nearest of these.
    """
    few, _ = views.sample_surface(mesh, count=_TESTED, seed=spec.seed + 1)
    is_seen = _find_visible(few, scene, distance=spec.distance)
    drawn = int(spec.visible_points / max(is_seen.mean(), _LEAST_SEEN))
    points, _ = views.sample_surface(mesh, count=drawn, seed=spec.seed)
    if is_seen.any():
        is_near = is_seen[KDTree(few).query(points, k=_NEAR)[1]].any(axis=1)
        is_near[is_near] = _find_visible(points[is_near], scene, distance=spec.distance)
        points = points[is_near] if is_near.any() else few[is_seen]
    # About as many as asked for, or repeated. They lie in the order of the faces.
    points = points[find_rows(len(points), spec.visible_points)]
    return np.round((points + 0.5) * VISIBLE_STEPS).astype(np.uint16)


def _thin_points(points, *, voxel):
    """One point for each occupied voxel: the mean of the points in it, [P, 3] float32.

    Voxels are cubes of side `voxel` with a corner at the origin. The result is in the
    order of the voxels; the order of the points changes it by rounding only.
    """
    points = np.asarray(points, dtype=np.float64)
    cells = np.floor(points / voxel).astype(np.int64)
    cells -= cells.min(axis=0)
    keys = np.ravel_multi_index(tuple(cells.T), cells.max(axis=0) + 1)
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
        origins = np.full_like(directions, eye)
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
