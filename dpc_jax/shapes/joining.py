"""Joining pieces of meshes into one."""

from collections.abc import Sequence

import numpy as np


def join_pieces(
    pieces: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices [N, 3], faces [F, 3] and colours [F, 4] of pieces that become one."""
    vertices, faces, colors = zip(*pieces, strict=True)
    starts = np.cumsum([0, *map(len, vertices)])[:-1]
    faces = [part + start for part, start in zip(faces, starts, strict=True)]
    return np.concatenate(vertices), np.concatenate(faces), np.concatenate(colors)
