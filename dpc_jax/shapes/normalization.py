"""Meshes that are joined from pieces, and brought to their place and size."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh


def normalize(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Copy of a mesh, centred on its bounding box and scaled to a box diagonal of 1.

    Raises:
      ValueError: if the mesh has no extent.
    """
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    diagonal = float(np.linalg.norm(high - low))
    if not diagonal > 0:
        raise ValueError(
            f"Expected a mesh with an extent, but its box diagonal is {diagonal}; "
            "skip it."
        )
    moved = mesh.copy()
    moved.vertices = (vertices - (low + high) / 2) / diagonal
    return moved


def face_colors(mesh: trimesh.Trimesh) -> np.ndarray:
    """Colours [F, 4] uint8 of a mesh without textures."""
    visual: Any = mesh.visual  # checkers think of textures, which have none
    return np.asarray(visual.face_colors)


def join_pieces(
    pieces: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices [N, 3], faces [F, 3] and colours [F, 4] of pieces that become one."""
    vertices, faces, colors = zip(*pieces, strict=True)
    return *trimesh.util.append_faces(vertices, faces), np.concatenate(colors)
