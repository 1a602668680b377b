"""The training set's mean shape as a prediction: what comes of seeing no image.

Where surfaces of training shapes are most often: the fullest cells of a fine grid, each
with the mean of the surface points in it. How many cells are taken is tuned on
validation shapes. It is told the true surfaces of the training set, the parts inside of
objects too, which models that learn from views never see.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from dpc_jax.config import Config
from dpc_jax.data import load_or_render
from dpc_jax.data.dataset import is_prepared
from dpc_jax.evaluation.chamfer import Chamfer, chamfer_distance
from dpc_jax.run.setup import make_data_specs

SIDE = 64  # cells of the unit cube along a side
COUNTS = (500, 1000, 2000, 4000, 8000, 16_000)  # of cells, to choose from
_VALIDATED = 20  # shapes that the number is tuned on, as many as align


def measure(config: Config) -> dict[str, float]:
    """Chamfer distance, precision and coverage (times 100) on the test shapes.

    Args:
      config: of a run on the same data.

    Raises:
      ValueError: for data that are not prepared, or without true shapes.
      OSError: where they cannot be read.
    """
    cache, specs = config.data.cache_dir, make_data_specs(config)
    if not all(is_prepared(spec, cache) for spec in specs.values()):
        raise ValueError(
            f"Expected the data of a finished run in {cache}, but they are not there; "
            "name their folder with --data=DIR."
        )
    sets = {
        name: load_or_render(spec, cache_dir=cache, progress=False)
        for name, spec in specs.items()
    }
    lacking = [name for name, data in sets.items() if data.surfaces is None]
    if lacking:
        raise ValueError(
            f"Expected true shapes for a mean shape, but the {lacking[0]} objects have "
            "none; leave its row out."
        )
    train, val, test = (sets[name].surfaces for name in ("train", "val", "test"))
    shares, places = average_surfaces(train)
    judged = [np.asarray(val[i]) for i in range(min(_VALIDATED, len(val)))]
    clouds = [take_fullest(shares, places, count) for count in COUNTS]
    best = min(clouds, key=lambda cloud: _average(cloud, judged).chamfer)
    found = _average(best, [np.asarray(test[i]) for i in range(len(test))])
    return found.in_paper_units() | {"mean_shape_points": float(len(best))}


def average_surfaces(
    surfaces: Sequence[Any], *, side: int = SIDE
) -> tuple[np.ndarray, np.ndarray]:
    """How many surfaces pass each cell of the unit cube, and where.

    Args:
      surfaces: [P, 3] points of each shape.

    Returns:
      ([side³] share of the shapes, [side³, 3] mean place of their points; where there
      is none, 0).
    """
    passed = np.zeros(side**3)
    counts, sums = np.zeros(side**3), np.zeros((side**3, 3))
    for surface in surfaces:
        points = np.asarray(surface, np.float64)
        cells = np.clip(np.floor((points + 0.5) * side), 0, side - 1).astype(int)
        flat = np.ravel_multi_index(tuple(cells.T), (side,) * 3)
        passed[np.unique(flat)] += 1
        counts += np.bincount(flat, minlength=side**3)
        for axis in range(3):
            weights = points[:, axis]
            sums[:, axis] += np.bincount(flat, weights, minlength=side**3)
    return passed / len(surfaces), sums / np.maximum(counts, 1)[:, None]


def take_fullest(shares: np.ndarray, places: np.ndarray, count: int) -> np.ndarray:
    """The places of the `count` cells that most surfaces pass; fewer if they are."""
    order = np.argsort(-shares, kind="stable")[:count]
    return places[order[shares[order] > 0]]


def _average(cloud, surfaces) -> Chamfer:
    """Mean distances of one cloud from many shapes."""
    found = [
        chamfer_distance(cloud, surface, tree=KDTree(surface)) for surface in surfaces
    ]
    return Chamfer(*np.mean(found, axis=0).tolist())
