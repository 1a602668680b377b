"""Point clouds and surfaces as files: PLY for point cloud tools, GLB for viewers."""

import json
import os
import struct
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from dpc_jax.files import write_bytes

_RADIUS = 0.008  # object units; a third of the spacing of 2000 points on a car
_PLAIN_COLOR = (0.36, 0.53, 0.73)  # sRGB, for points that carry no colour

_CORNERS = np.concatenate([np.eye(3), -np.eye(3)])  # octahedron: +x +y +z -x -y -z
_FACES = np.array(  # counter-clockwise seen from outside
    [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2]]
    + [[1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
)
# The object frame has z up and x to the front, glTF y up and z to the front: the three
# axes change places, which is this unit quaternion (xyzw, as glTF orders it).
_UPRIGHT = [-0.5, -0.5, -0.5, 0.5]


def write_ply(
    path: str | os.PathLike, points: ArrayLike, colors: ArrayLike | None = None
) -> Path:
    """Write points [N, 3] as binary PLY, float32, with sRGB bytes where colours exist.

    Args:
      path: where to; replaced only once the new file is whole.
      points: [N, 3] object frame.
      colors: [N, 3] bytes 0-255, or floats 0-1 (clipped); left out of the file if None.

    Raises:
      ValueError: points or colours that are not finite or not [N, 3].
    """
    points, colors = _check_cloud(points, colors)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    rows = np.ascontiguousarray(points, "<f4").view(
        "u1"
    )  # a row of bytes for each point
    if colors is not None:
        header += [f"property uchar {name}" for name in ("red", "green", "blue")]
        rows = np.hstack([rows, _bytes(colors)])
    text = "\n".join([*header, "end_header"]) + "\n"
    return write_bytes(path, text.encode("ascii") + rows.tobytes())


def write_glb(
    path: str | os.PathLike,
    points: ArrayLike,
    colors: ArrayLike | None = None,
    *,
    radius: float = _RADIUS,
) -> Path:
    """Write points [N, 3] as binary glTF, each a small octahedron shaded as a ball.

    Viewers draw glTF's own points one pixel wide, which is hard to see. The vertices
    stay in the object frame; the node's rotation stands the object upright.

    Args:
      path: where to; replaced only once the new file is whole.
      points: [N, 3] object frame, at least one.
      colors: [N, 3] bytes 0-255, or floats 0-1 (clipped); a plain blue if None.
      radius: of an octahedron, in units of the points.

    Raises:
      ValueError: no points, points or colours that are not finite or not [N, 3], or a
        radius that is not positive.
    """
    points, colors = _check_cloud(points, colors)
    if len(points) == 0 or not (np.isfinite(radius) and radius > 0.0):
        raise ValueError(
            f"Expected at least one point and a positive radius, but there are "
            f"{len(points)} points and the radius is {radius}; a GLB file cannot hold "
            f"an empty mesh."
        )
    if colors is None:
        colors = np.broadcast_to(_PLAIN_COLOR, points.shape)
    corners = len(_CORNERS)
    position = (points[:, None] + radius * _CORNERS).reshape(-1, 3).astype("<f4")
    normal = np.tile(_CORNERS, (len(points), 1)).astype("<f4")
    # glTF vertex colours are linear light; pictures and PLY hold sRGB.
    curve = ((colors + 0.055) / 1.055) ** 2.4
    linear = np.where(colors <= 0.04045, colors / 12.92, curve)
    rgba = np.full((len(points), 4), 255, dtype="u1")
    rgba[:, :3] = _bytes(linear)
    faces = _FACES + corners * np.arange(len(points))[:, None, None]
    colors = np.repeat(rgba, corners, axis=0)
    return write_bytes(path, _assemble_glb(position, normal, colors, faces, "points"))


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
      ValueError: no faces, or vertices that are not finite or not [V, 3].
    """
    vertices, _ = _check_cloud(vertices, None)
    faces = np.asarray(faces)
    if not len(faces):
        raise ValueError(
            "Expected a surface with faces, but there are none; a GLB file cannot hold "
            "an empty mesh."
        )
    # Of each vertex the mean direction of its faces, by their areas.
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    normals = np.zeros_like(vertices)
    np.add.at(normals, faces, np.cross(b - a, c - a)[:, None])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals /= np.where(length > 0, length, 1)
    rgba = np.full((len(vertices), 4), 255, dtype="u1")
    rgba[:, :3] = _bytes(np.array(_PLAIN_COLOR) ** 2.2)  # nearly linear light
    arrays = vertices.astype("<f4"), normals.astype("<f4"), rgba, faces
    return write_bytes(path, _assemble_glb(*arrays, "surface"))


def _assemble_glb(position, normal, colors, faces, name) -> bytes:
    """One mesh of vertices with normals and colours [V, 4], and faces of indices."""
    parts = [
        (position, 5126, "VEC3", 34962),
        (normal, 5126, "VEC3", 34962),
        (colors, 5121, "VEC4", 34962),
        (faces.reshape(-1).astype("<u4"), 5125, "SCALAR", 34963),
    ]
    views, accessors, offset = [], [], 0
    for index, (array, component, kind, target) in enumerate(parts):
        place = {"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes}
        views.append(place | {"target": target})
        content = {"componentType": component, "count": len(array), "type": kind}
        accessors.append({"bufferView": index} | content)
        offset += array.nbytes
    accessors[0]["min"] = parts[0][0].min(axis=0).tolist()
    accessors[0]["max"] = parts[0][0].max(axis=0).tolist()
    accessors[2]["normalized"] = True
    attributes = {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}
    primitive = {"attributes": attributes, "indices": 3, "material": 0}
    # The default material is metal, which is black where nothing is reflected.
    surface = {"metallicFactor": 0.0, "roughnessFactor": 0.8}
    scene = {
        "asset": {"version": "2.0", "generator": "dpc_jax"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name, "rotation": _UPRIGHT}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": surface}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    text = json.dumps(scene, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    binary = b"".join(array.tobytes() for array, *_ in parts)  # multiples of 4 bytes
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.round(255.0 * values).astype("u1")


def _check_cloud(points, colors) -> tuple[np.ndarray, np.ndarray | None]:
    """Points in float64 and colours as floats 0-1, both checked."""
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(
            f"Expected finite points [N, 3], but the shape is {points.shape} and "
            f"{int((~np.isfinite(points)).sum())} coordinates are not finite; viewers "
            f"could not open such a file."
        )
    if colors is None:
        return points, None
    colors = np.asarray(colors)
    scale = 255.0 if colors.dtype == np.uint8 else 1.0
    colors = colors.astype(np.float64) / scale
    if colors.shape != points.shape or not np.isfinite(colors).all():
        raise ValueError(
            f"colors must be finite and of the points' shape {points.shape}, but they "
            f"are not finite or of shape {colors.shape}; pass one RGB colour for each "
            f"point, bytes 0-255 or floats 0-1."
        )
    return points, np.clip(colors, 0.0, 1.0)
