"""Clouds as PLY, for tools of points and splats; surfaces as GLB, PLY or OBJ."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from dpc_jax.evaluation.chamfer import check_points
from dpc_jax.files import SURFACES, write_bytes
from dpc_jax.reporting.examples import Example

PLAIN_COLOR = (0.36, 0.53, 0.73)  # sRGB, for points that carry no colour
# As files of Gaussian splats have them: (c - 1/2) / Y₀₀ of a colour c, and the logit of
# the opacity.
_HARMONIC = 0.28209479177387814
_SPLAT = ("f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2")
_SPLAT += ("rot_0", "rot_1", "rot_2", "rot_3")
_OPACITY = 4.6  # 0.99
_LEAST_SIZE = 1e-4  # of a splat, object units
# The object frame has z up and x to the front, glTF y up and z to the front: the three
# axes change places.
_UPRIGHT = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], float)


def write_ply(
    path: str | os.PathLike, points: ArrayLike, colors: ArrayLike | None = None
) -> Path:
    """Write points [N, 3] as binary PLY, float32, with sRGB bytes where colours exist.

    Each point has the properties of a Gaussian splat too (Kerbl et al., 3D Gaussian
    Splatting, 2023), as wide as half the way to its three nearest neighbours: viewers
    of splats draw a cloud without gaps.

    Args:
      points: [N, 3] object frame.
      colors: [N, 3] of 0 to 1 (clipped); left out of the file if None, and splats are
        plain blue.

    Raises:
      ValueError: no point, or points that are not finite or not [N, 3].
    """
    points, colors = check_points(points, name="points"), _clip(colors)
    count, names = len(points), (*"xyz", *_SPLAT)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header += [f"property float {name}" for name in names]
    shown = np.broadcast_to(PLAIN_COLOR, (count, 3)) if colors is None else colors
    sizes = np.log(np.maximum(_measure_gaps(points) / 2, _LEAST_SIZE))
    fixed = np.broadcast_to([_OPACITY, 0, 0, 0, 1, 0, 0, 0], (count, 8)).copy()
    fixed[:, 1:4] = sizes[:, None]
    values = np.hstack([points, (shown - 0.5) / _HARMONIC, fixed])
    rows = np.ascontiguousarray(values, "<f4").view("u1")  # a row for each point
    if colors is not None:
        header += [f"property uchar {name}" for name in ("red", "green", "blue")]
        rows = np.hstack([rows, _bytes(colors)])
    text = "\n".join([*header, "end_header"]) + "\n"
    return write_bytes(path, text.encode("ascii") + rows.tobytes())


def _measure_gaps(points):
    """Mean distance [N] to the three nearest other points; 0 of a lone point."""
    count = min(4, len(points))
    if count < 2:
        return np.zeros(len(points))
    return KDTree(points).query(points, k=count)[0][:, 1:].mean(axis=1)


def write_surface(
    path: str | os.PathLike,
    vertices: ArrayLike,
    faces: ArrayLike,
    colors: ArrayLike | None = None,
) -> Path:
    """Write a surface, smoothly shaded, as its path ends: .glb, .ply or .obj.

    The vertices stay in the object frame; the node's rotation in a GLB file stands the
    object upright.

    Args:
      vertices: [V, 3] object frame. faces: [F, 3] of their indices, at least one,
        counter-clockwise seen from outside.
      colors: [V, 3] of 0 to 1 (clipped); a plain blue if None.

    Raises:
      ValueError: no vertex, or vertices that are not finite or not [V, 3].
    """
    path = Path(path)
    if path.suffix == ".glb":
        return write_bytes(path, export_glb(vertices, faces, colors))
    data = _make_mesh(vertices, faces, colors).export(file_type=path.suffix[1:])
    return write_bytes(path, data.encode() if path.suffix == ".obj" else data)


def export_glb(
    vertices: ArrayLike, faces: ArrayLike, colors: ArrayLike | None = None
) -> bytes:
    """The content of a GLB file; the arguments are those of `write_surface`."""
    import trimesh

    mesh = _make_mesh(vertices, faces, colors, is_linear=True)
    scene = trimesh.Scene()
    scene.add_geometry(
        mesh, geom_name="surface", node_name="surface", transform=_UPRIGHT
    )

    def finish(tree):
        # The default material is metal, which is black where nothing is reflected.
        surface = {"metallicFactor": 0.0, "roughnessFactor": 0.8}
        tree["materials"] = [{"pbrMetallicRoughness": surface}]
        tree["meshes"][0]["primitives"][0]["material"] = 0

    options: Any = {"include_normals": True, "tree_postprocessor": finish}
    data: Any = scene.export(file_type="glb", **options)
    return data


def _make_mesh(vertices, faces, colors, *, is_linear: bool = False) -> Any:
    import trimesh  # takes half a second to load: clouds as PLY do without
    from trimesh.visual.color import srgb_to_linear

    vertices, colors = check_points(vertices, name="vertices"), _clip(colors)
    if colors is None:
        colors = np.broadcast_to(PLAIN_COLOR, vertices.shape)
    if is_linear:
        # glTF vertex colours are linear light; pictures, PLY and OBJ hold sRGB.
        colors = srgb_to_linear(colors)
    rgba = np.full((len(vertices), 4), 255, dtype="u1")
    rgba[:, :3] = _bytes(colors)
    return trimesh.Trimesh(vertices, faces, vertex_colors=rgba, process=False)


def write_files(example: Example, stem: Path, *, surface: str = "glb") -> Path:
    """STEM.ply of an example's points, and its surface beside it.

    Args:
      surface: one of `SURFACES`.

    Returns:
      The path of the surface.
    """
    write_ply(stem.with_name(f"{stem.name}.ply"), example.points, example.colors)
    vertices, faces, colors = find_surface(example.points, example.colors, example.mesh)
    path = stem.with_name(f"{stem.name}{SURFACES[surface]}")
    return write_surface(path, vertices, faces, colors)


def find_surface(
    points: np.ndarray,
    colors: np.ndarray | None = None,
    mesh: tuple[np.ndarray, ...] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Vertices, faces and colours of the surface around a cloud [N, 3].

    Args:
      colors: [N, 3] of the points; a vertex has the mean of its three nearest.
      mesh: vertices and faces that are known already.
    """
    from dpc_jax.evaluation.wrapping import wrap_points  # needs scikit-image

    vertices, faces = mesh or wrap_points(points)
    if colors is not None:
        nearest = KDTree(points).query(vertices, k=min(3, len(colors)))[1]
        colors = colors[np.reshape(nearest, (len(vertices), -1))].mean(axis=1)
    return vertices, faces, colors


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.round(255.0 * values).astype("u1")


def _clip(colors: ArrayLike | None) -> np.ndarray | None:
    return None if colors is None else np.clip(np.asarray(colors, float), 0.0, 1.0)
