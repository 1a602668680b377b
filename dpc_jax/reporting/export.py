"""Point clouds and surfaces as files: PLY for point cloud tools, GLB for viewers."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dpc_jax.files import write_bytes
from dpc_jax.reporting.examples import Example

RADIUS = 0.008  # of a point, object units; a third of 2000 points' spacing on a car
_PLAIN_COLOR = (0.36, 0.53, 0.73)  # sRGB, for points that carry no colour

_CORNERS = np.concatenate([np.eye(3), -np.eye(3)])  # octahedron: +x +y +z -x -y -z
_FACES = np.array(  # counter-clockwise seen from outside
    [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2]]
    + [[1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
)
# The object frame has z up and x to the front, glTF y up and z to the front: the three
# axes change places.
_UPRIGHT = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], float)


def write_ply(
    path: str | os.PathLike, points: ArrayLike, colors: ArrayLike | None = None
) -> Path:
    """Write points [N, 3] as binary PLY, float32, with sRGB bytes where colours exist.

    Args:
      path: where to; replaced only once the new file is whole.
      points: [N, 3] object frame.
      colors: [N, 3] of 0 to 1 (clipped); left out of the file if None.

    Raises:
      ValueError: points that are not finite or not [N, 3].
    """
    points, colors = _check_cloud(points, colors)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    rows = np.ascontiguousarray(points, "<f4").view("u1")  # a row for each point
    if colors is not None:
        header += [f"property uchar {name}" for name in ("red", "green", "blue")]
        rows = np.hstack([rows, _bytes(colors)])
    text = "\n".join([*header, "end_header"]) + "\n"
    return write_bytes(path, text.encode("ascii") + rows.tobytes())


def write_glb(
    path: str | os.PathLike, points: ArrayLike, colors: ArrayLike | None = None
) -> Path:
    """Write points [N, 3] as binary glTF, each a small octahedron shaded as a ball.

    Viewers draw glTF's own points one pixel wide, which is hard to see. The vertices
    stay in the object frame; the node's rotation stands the object upright.

    Args:
      path: where to; replaced only once the new file is whole.
      points: [N, 3] object frame, at least one.
      colors: [N, 3] of 0 to 1 (clipped); a plain blue if None.

    Raises:
      ValueError: points that are not finite or not [N, 3].
    """
    points, colors = _check_cloud(points, colors)
    if colors is None:
        colors = np.broadcast_to(_PLAIN_COLOR, points.shape)
    corners = len(_CORNERS)
    position = (points[:, None] + RADIUS * _CORNERS).reshape(-1, 3).astype("<f4")
    normal = np.tile(_CORNERS, (len(points), 1)).astype("<f4")
    # glTF vertex colours are linear light; pictures and PLY hold sRGB.
    curve = ((colors + 0.055) / 1.055) ** 2.4
    linear = np.where(colors <= 0.04045, colors / 12.92, curve)
    rgba = np.full((len(points), 4), 255, dtype="u1")
    rgba[:, :3] = _bytes(linear)
    faces = (_FACES + corners * np.arange(len(points))[:, None, None]).reshape(-1, 3)
    colors = np.repeat(rgba, corners, axis=0)
    return _write_mesh(path, position, normal, faces, colors, "points")


def write_surface(
    path: str | os.PathLike, vertices: ArrayLike, faces: ArrayLike
) -> Path:
    """Write a surface as binary glTF, smoothly shaded in plain blue.

    As in `write_glb` the vertices stay in the object frame.

    Args:
      path: where to; replaced only once the new file is whole.
      vertices: [V, 3] object frame. faces: [F, 3] of their indices, at least one,
        counter-clockwise seen from outside.

    Raises:
      ValueError: for vertices that are not finite or not [V, 3].
    """
    vertices, _ = _check_cloud(vertices, None)
    rgba = np.full((len(vertices), 4), 255, dtype="u1")
    rgba[:, :3] = _bytes(np.array(_PLAIN_COLOR) ** 2.2)  # nearly linear light
    return _write_mesh(path, vertices, None, faces, rgba, "surface")


def write_files(example: Example, stem: Path):
    """STEM.ply of an example's points, and STEM.glb of them or of its surface."""
    write_ply(stem.with_name(f"{stem.name}.ply"), example.points, example.colors)
    glb = stem.with_name(f"{stem.name}.glb")
    if example.mesh is not None:
        write_surface(glb, *example.mesh)
    else:
        write_glb(glb, example.points, example.colors)


def _write_mesh(path, vertices, normals, faces, colors, name) -> Path:
    """A mesh with colours [V, 4]; without normals it is shaded smoothly."""
    import trimesh  # takes half a second to load: clouds as PLY do without

    mesh = trimesh.Trimesh(
        vertices, faces, vertex_normals=normals, vertex_colors=colors, process=False
    )
    scene = trimesh.Scene()
    scene.add_geometry(mesh, geom_name=name, node_name=name, transform=_UPRIGHT)

    def finish(tree):
        # The default material is metal, which is black where nothing is reflected.
        surface = {"metallicFactor": 0.0, "roughnessFactor": 0.8}
        tree["materials"] = [{"pbrMetallicRoughness": surface}]
        tree["meshes"][0]["primitives"][0]["material"] = 0

    options = {"include_normals": True, "tree_postprocessor": finish}
    data: Any = scene.export(file_type="glb", **options)
    return write_bytes(path, data)


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.round(255.0 * values).astype("u1")


def _check_cloud(points, colors) -> tuple[np.ndarray, np.ndarray | None]:
    """Finite points and colours of 0 to 1, in float64."""
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(
            f"Expected finite points [N, 3], but the shape is {points.shape} and "
            f"{int((~np.isfinite(points)).sum())} coordinates are not finite; viewers "
            f"could not open such a file."
        )
    if colors is not None:
        colors = np.clip(np.asarray(colors, np.float64), 0.0, 1.0)
    return points, colors
