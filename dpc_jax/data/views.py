"""Views of a mesh by ray casting: shaded colour, antialiased mask, metric depth.

Rays start at the camera with a direction whose z component (camera frame) is one, so
the ray parameter of a hit *is* its depth. Shading is flat: a colour per face and view.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import trimesh
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

from dpc_jax.data.spec import SUPERSAMPLE
from dpc_jax.shapes.normalization import face_colors

WHITE = 255.0


class View(NamedTuple):
    """One rendered view.

    image: uint8 [S, S, 3], on white, already blended with the antialiased mask.
    mask: uint8 [S, S], share of the pixel that the object covers, times 255.
    depth: float32 [S, S], mean z over the covered samples of the pixel in the units of
        the mesh (camera at 0); 0 where nothing is covered.
    """

    image: np.ndarray
    mask: np.ndarray
    depth: np.ndarray


class Lights(NamedTuple):
    """Directional lights of one view: towards [L, 3] (object frame), strength [L]."""

    towards: np.ndarray
    strength: np.ndarray
    ambient: float


class Scene(NamedTuple):
    """A mesh made ready for ray casting, to be shared by all its views."""

    embree: Any  # rtcore_scene.EmbreeScene, a compiled class that checkers cannot see
    vertices: np.ndarray  # [N, 3]
    centroids: np.ndarray  # [F, 3]
    normals: np.ndarray  # [F, 3], unit length, 0 for a face without area
    colors: np.ndarray  # [F, 3], 0..255


def draw_lights(rng: np.random.Generator) -> Lights:
    """One to three random lights in the upper hemisphere, and ambient light.

    Source: paper, "random light source positions". The strengths are ours, chosen so
    that a face turned to a light keeps its colour and one in shadow stays visible.
    """
    count = int(rng.integers(1, 4))
    azimuth = rng.uniform(0.0, 2.0 * np.pi, count)
    height = rng.uniform(0.15, 1.0, count)  # sine of the elevation: uniform on a sphere
    flat = np.sqrt(1.0 - height**2)
    towards = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height], -1)
    strength = rng.uniform(0.5, 1.0, count)
    ambient = float(rng.uniform(0.3, 0.4))
    return Lights(towards, 0.65 * strength / strength.sum(), ambient)


def build_scene(mesh: trimesh.Trimesh) -> Scene:
    """Make a mesh ready for `render_view`; colours are its face colours."""
    vertices = np.ascontiguousarray(mesh.vertices, dtype=np.float32)
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int32)
    embree = rtcore_scene.EmbreeScene()  # pyright: ignore[reportAttributeAccessIssue]
    TriangleMesh(embree, vertices, faces)
    corners = vertices[faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    colors = face_colors(mesh)[:, :3].astype(np.float64)
    return Scene(embree, vertices, corners.mean(axis=1), normals, colors)


def _shade_faces(scene, *, eye, lights):
    """Lambert shading, one colour per face [F, 3] in 0..255."""
    # turned towards the camera: files full of open shells have no reliable outside
    facing = np.einsum("fc,fc->f", scene.normals, eye - scene.centroids)
    normals = np.where(facing[:, None] < 0, -scene.normals, scene.normals)
    diffuse = np.maximum(normals @ lights.towards.T, 0.0) @ lights.strength
    return np.minimum(scene.colors * (lights.ambient + diffuse)[:, None], WHITE)


@functools.lru_cache(maxsize=4)
def _camera_rays(image_size, focal_length):
    """Directions [k*k, S, S, 3] in the camera frame, z = 1.

    Sub-samples come first: a sum over the first axis is several times cheaper.
    """
    count = image_size * SUPERSAMPLE
    plane = ((np.arange(count) + 0.5) / count - 0.5) / focal_length
    plane = plane.reshape(image_size, SUPERSAMPLE).T  # [k, S]
    shape = (SUPERSAMPLE, SUPERSAMPLE, image_size, image_size)
    rays = np.ones((*shape, 3), dtype=np.float32)
    rays[..., 0] = plane[None, :, None, :]
    rays[..., 1] = plane[:, None, :, None]
    return rays.reshape(SUPERSAMPLE**2, image_size, image_size, 3)


def _crop_box(scene, rotation, image_size, focal_length, shift):
    """Rows and columns (start, stop) outside of which no ray can hit the mesh."""
    seen = scene.vertices @ rotation.T + shift
    depth = seen[:, 2]
    if depth.min() <= 1e-3 * shift[2]:
        return 0, image_size, 0, image_size  # behind the camera: no bound, cast all
    plane = seen[:, :2] * (focal_length / depth)[:, None]
    cells = (plane + 0.5) * image_size
    low = np.clip(np.floor(cells.min(axis=0)) - 1, 0, image_size).astype(int)
    high = np.clip(np.ceil(cells.max(axis=0)) + 1, 0, image_size).astype(int)
    return low[1], high[1], low[0], high[0]


def render_view(
    scene: Scene,
    rotation: np.ndarray,
    *,
    lights: Lights,
    image_size: int,
    focal_length: float = 1.875,
    distance: float = 2.0,
    translation: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
) -> View:
    """Render one view of a mesh that `build_scene` has made ready.

    u = focal x / z and v = focal y / z with z = z_rotated + distance; the image of
    `image_size` pixels a side spans [-1/2, 1/2] in u and v, row 0 at the top.
    `rotation` [3, 3] takes the object frame to the camera frame, where `translation`
    [3] moves the object; that and `distance` are in the units of the mesh.
    `SUPERSAMPLE` rays per pixel are cast along each image axis.
    """
    rotation = np.asarray(rotation, dtype=np.float64)
    shift = np.asarray(translation, dtype=np.float64) + [0.0, 0.0, distance]
    eye = -shift @ rotation
    image = np.full((image_size, image_size, 3), 255, dtype=np.uint8)
    mask = np.zeros((image_size, image_size), dtype=np.uint8)
    depth = np.zeros((image_size, image_size), dtype=np.float32)

    top, bottom, left, right = _crop_box(
        scene, rotation, image_size, focal_length, shift
    )
    rays = _camera_rays(image_size, float(focal_length))
    rays = rays[:, top:bottom, left:right]
    shape = rays.shape[:3]
    directions = rays.reshape(-1, 3) @ rotation.astype(np.float32)
    hits = scene.embree.run(np.full_like(directions, eye), directions, output=True)

    face = hits["primID"]
    # the last row stands for a miss (index -1): the white background
    colors = np.full((len(scene.colors) + 1, 3), WHITE, dtype=np.float32)
    colors[:-1] = _shade_faces(scene, eye=eye, lights=lights)
    total = colors[face].reshape(*shape, 3).sum(axis=0)
    found = (face >= 0).reshape(shape)
    covered = found.sum(axis=0, dtype=np.float32)
    travelled = np.where(found, hits["tfar"].reshape(shape), 0.0).sum(axis=0)

    here = np.s_[top:bottom, left:right]
    image[here] = np.rint(total / shape[0])
    mask[here] = np.rint(covered * (255.0 / shape[0]))
    depth[here] = travelled / np.maximum(covered, 1.0)
    return View(image, mask, depth)


def sample_surface(
    mesh: trimesh.Trimesh, *, count: int, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Points [count, 3] float32, uniform by area, and the face [count] of each.

    Open shells and interiors are part of the surface.

    Raises:
      ValueError: if the mesh has no area.
    """
    rng = np.random.default_rng(seed)
    corners = np.asarray(mesh.vertices, dtype=np.float64)[np.asarray(mesh.faces)]
    edges = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1)
    if not area.sum() > 0:
        raise ValueError(
            "Expected a mesh with area to sample, but it has none; skip it."
        )
    # stratified along the running area: less clumping than independent draws
    levels = (np.arange(count) + rng.uniform(size=count)) / count * area.sum()
    face = np.minimum(np.searchsorted(np.cumsum(area), levels), len(area) - 1)
    a, b = rng.uniform(size=(2, count, 1))
    outside = a + b > 1  # the other half of the parallelogram, folded back
    a, b = np.where(outside, 1 - a, a), np.where(outside, 1 - b, b)
    points = corners[face, 0] + a * edges[face, 0] + b * edges[face, 1]
    return points.astype(np.float32), face
