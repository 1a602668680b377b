"""A closed surface around a cloud of points, for viewers, printers and measures.

Balls about the points close the gaps between them; what they enclose is filled; then
all is shrunk again by the balls' radius, but for a little that keeps thin parts. This
is the closing of mathematical morphology (Serra, Image Analysis and Mathematical
Morphology, 1982), on a grid of distances, whose level set is drawn by marching cubes.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

MOST_FACES = 20_000
_SIDE = 96  # cells along the unit cube, at the most
_MOST_CELLS = 4_000_000  # of a cloud that reaches far beyond it
# The balls reach the sixth nearest neighbour of four points of five.
_NEIGHBOURS, _SHARE = 6, 0.8
_LEAST_RADIUS, _MOST_RADIUS = 0.01, 0.08
_COARSE = 48  # cells along the unit cube, while the radius is chosen
_WIDER, _LEAK = 1.4, 2.0  # ratios of radii that are tried, and of volumes that tell
_SPECK = 4  # cells; smaller parts are left out, of which stray points make dust
_KEPT = 0.001  # half the thickness of a sheet of points, object units
# How deep in the solid the cells of points are: with more, thin parts are thicker.
_DEPTH = 0.002
# Without stray points that wider balls would connect: rods and sheets stay whole.
_SHARE_FITTED, _KEPT_FITTED = 0.95, 0.009


def wrap_points(
    points: ArrayLike, *, is_fitted: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """The surface of a solid that the points [N, 3] cover, at least one of them.

    Args:
      points: finite, object units.
      is_fitted: whether none of them strays, as in fits of one object: the balls reach
        the neighbours of nearly all of them, and more of a sheet's thickness is kept.

    Returns:
      (vertices [V, 3], object units; faces [F, 3] of their indices, counter-clockwise
      seen from outside). The surface is closed, and it may have several parts; a
      coarser grid is taken until it has at most `MOST_FACES`.
    """
    points = np.asarray(points, np.float64)
    count = min(_NEIGHBOURS + 1, len(points))  # a point is its own nearest
    distances = np.reshape(KDTree(points).query(points, k=count)[0], (len(points), -1))
    share, kept = (_SHARE_FITTED, _KEPT_FITTED) if is_fitted else (_SHARE, _KEPT)
    radius = max(float(np.quantile(distances[:, -1], share)), _LEAST_RADIUS)
    radius = _close_holes(points, radius, kept)
    side = _SIDE
    while True:
        field, low, side = _measure_depth(points, radius, side)
        # A cell of a point belongs to the solid: rods thinner than a cell stay whole.
        cells = tuple((np.floor(points * side).astype(int) - low).T)
        field[cells] = np.maximum(field[cells], radius - kept + _DEPTH)
        # A lone point may be shallower, where no cell's centre is near it.
        level = min(radius - kept, 0.5 * field.max())
        field = _drop_specks(field, level)
        # Triangles wound as seen from outside, where values are low.
        found: Any = marching_cubes(field, level, gradient_direction="ascent")
        vertices, faces = found[:2]
        if len(faces) <= MOST_FACES:
            places = (vertices + low + 0.5) / side
            return places.astype(np.float32), faces.astype(np.int64)
        side *= 0.97 * np.sqrt(MOST_FACES / len(faces))


def _close_holes(points, radius, kept):
    """A radius at which no larger one would fill much more.

    Through a single hole all that a surface encloses counts as outside.
    """

    def measure(radius):
        depth, *_ = _measure_depth(points, radius, _COARSE)
        return np.sum(depth > radius - kept)

    volume = measure(radius)
    while radius < _MOST_RADIUS:
        larger = _WIDER * radius
        filled = measure(larger)
        if filled < _LEAK * volume:
            break
        radius, volume = larger, filled
    return radius


def _drop_specks(field, level):
    """The field without parts above the level that have few cells, but the largest."""
    found: Any = ndimage.label(field > level)  # connected by faces, as the surface is
    sizes = np.bincount(found[0].ravel())
    sizes[0] = least = min(_SPECK, sizes[1:].max(initial=0))
    return np.where(sizes[found[0]] < least, level - 1e-6, field)


def _measure_depth(points, radius, side):
    """How deep each cell lies in the filled balls, negative outside of them.

    Returns:
      (depths [X, Y, Z], object units; the index [3] of the first cell; how many cells
      are along the unit cube: `side`, or fewer of points that lie far apart).
    """
    extent = np.prod(np.ptp(points, axis=0) + 2 * radius)
    side = min(side, (_MOST_CELLS / extent) ** (1 / 3))
    radius = max(radius, 1 / side)  # so that a ball holds a cell's centre
    low = np.floor((points.min(axis=0) - radius) * side).astype(int) - 2
    high = np.floor((points.max(axis=0) + radius) * side).astype(int) + 3
    cells = tuple((np.floor(points * side).astype(int) - low).T)
    is_empty, inside = np.ones(high - low, bool), np.zeros((*(high - low), 3))
    is_empty[cells] = False
    inside[cells] = points  # one of those in the cell
    centers = np.moveaxis((np.indices(high - low).T + low + 0.5).T / side, 0, -1)
    away = np.linalg.norm(centers - inside[_find_nearest(is_empty)], axis=-1)
    found: Any = ndimage.label(away > radius)
    parts = found[0]
    is_outside = parts == parts[0, 0, 0]
    rim = _find_nearest(~is_outside)
    # The balls end before the centre of the nearest cell outside of them.
    beyond = np.linalg.norm(centers - centers[rim], axis=-1) - (away[rim] - radius)
    return np.where(is_outside, radius - away, beyond), low, side


def _find_nearest(cells: np.ndarray) -> tuple[np.ndarray, ...]:
    """For each cell the place of the nearest one that is False."""
    found: Any = ndimage.distance_transform_edt(
        cells, return_distances=False, return_indices=True
    )
    return tuple(found)
