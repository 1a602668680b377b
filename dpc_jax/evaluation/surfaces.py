"""From occupancies to points: the surface at a threshold, and samples of it.

As the paper evaluates voxel models (appendix § Evaluation): marching cubes, about
10,000 samples, the threshold tuned on validation shapes.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from skimage.measure import marching_cubes

from dpc_jax.evaluation.chamfer import Surface

SAMPLES = 10_000  # "roughly 10000" points of a surface
THRESHOLDS = tuple(i / 40 for i in range(1, 40))
_FEW = 2000  # samples of a surface while the threshold is tuned


def extract_surface(cells: ArrayLike, threshold: float) -> tuple[np.ndarray, ...]:
    """The surface where occupancies pass a threshold, by marching cubes.

    Beyond the rim the volume counts as empty, so that surfaces are closed.

    Args:
      cells: [X, Y, Z] occupancies of the unit cube; cell i has its centre at
        (i + 1/2)/X - 1/2, as in `dpc_jax.project_volume`.
      threshold: in (0, 1).

    Returns:
      (vertices [V, 3], object frame; faces [F, 3] of their indices, counter-clockwise
      seen from outside). Both are empty where no cell is above the threshold.
    """
    cells = np.asarray(cells, np.float32)
    padded = np.pad(cells, 1)
    if not padded.max() > threshold:  # NaN is nowhere
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int64)
    # Triangles wound as seen from outside, where values are low.
    found: Any = marching_cubes(padded, threshold, gradient_direction="ascent")
    vertices, faces = found[:2]
    # Index 1 of the padded volume is cell 0.
    places = (vertices - 0.5) / np.array(cells.shape) - 0.5
    return places.astype(np.float32), faces.astype(np.int64)


def sample_surface(
    cells: ArrayLike, threshold: float, *, count: int = SAMPLES
) -> np.ndarray:
    """Points [count, 3] of the surface, uniform by area, always alike; object frame.

    Without a surface all are the centre of the fullest cell: an empty prediction is
    compared, not left out.
    """
    vertices, faces = extract_surface(cells, threshold)
    if not len(faces):
        cells = np.asarray(cells)
        fullest = np.unravel_index(np.argmax(cells), cells.shape)
        center = (np.array(fullest) + 0.5) / cells.shape - 0.5
        return np.tile(center.astype(np.float32), (count, 1))
    return draw_points(vertices, faces, count=count)


def draw_points(
    vertices: np.ndarray, faces: np.ndarray, *, count: int = SAMPLES
) -> np.ndarray:
    """Points [count, 3] of a surface, uniform by area, always alike."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    drawn: Any = trimesh.sample.sample_surface(mesh, count, seed=0)
    return np.asarray(drawn[0], np.float32)


def tune_threshold(
    volumes: Sequence[ArrayLike], surfaces: Sequence[ArrayLike]
) -> float:
    """The threshold of the least mean Chamfer distance on validation shapes.

    Every fourth of `THRESHOLDS` is tried, then those beside the best of these.

    Args:
      volumes: [X, Y, Z] occupancies of each shape, in the frame of its surface.
      surfaces: [P, 3] points of each true surface.
    """
    truths = [Surface(points) for points in surfaces]

    def measure(index):
        distances = []
        for cells, truth in zip(volumes, truths, strict=True):
            points = sample_surface(cells, THRESHOLDS[index], count=_FEW)
            distances.append(truth.compare(points).chamfer)
        return np.mean(distances)

    found = {index: measure(index) for index in range(0, len(THRESHOLDS), 4)}
    best = min(found, key=lambda index: found[index])
    for index in range(max(best - 3, 0), min(best + 4, len(THRESHOLDS))):
        if index not in found:
            found[index] = measure(index)
    return THRESHOLDS[min(found, key=lambda index: found[index])]
