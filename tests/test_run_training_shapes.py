"""The training shape that is nearest to a shape."""

import numpy as np

from dpc_jax.evaluation.chamfer import chamfer_distance
from dpc_jax.run.report.training_shapes import (
    average_surfaces,
    coarsen,
    find_nearest,
    take_fullest,
)


def make_boxes(count, seed=0, points=800):
    rng = np.random.default_rng(seed)
    sides = rng.uniform(0.1, 0.6, (count, 1, 3))
    return sides * rng.uniform(-0.5, 0.5, (count, points, 3))


def test_the_shortlist_loses_little_against_comparing_all():
    boxes, others = make_boxes(80, points=500), make_boxes(6, seed=1, points=500)
    coarse = coarsen(boxes)
    excess = []
    for other in others:
        nearest = boxes[find_nearest(boxes.__getitem__, coarse, other)]
        found = chamfer_distance(nearest, other).chamfer
        best = min(chamfer_distance(box, other).chamfer for box in boxes)
        excess.append(found / best - 1)
    # Sampling noise of 500 points decides between shapes that are nearly as near.
    assert np.mean(excess) < 0.02 and max(excess) < 0.1


def test_cells_count_shapes_once_and_have_the_mean_of_all_points():
    first = np.array([[0.3, 0.3, 0.3], [0.35, 0.3, 0.3], [-0.4, 0, 0]])
    second = np.array([[0.4, 0.3, 0.3], [0.4, 0.3, -0.3]])
    shares, places = average_surfaces([first, second], side=2)
    by_cell = shares.reshape(2, 2, 2)
    assert by_cell[1, 1, 1] == 1.0 and by_cell[1, 1, 0] == by_cell[0, 1, 1] == 0.5
    assert shares.sum() == 2.0
    np.testing.assert_allclose(places[np.argmax(shares)], [0.35, 0.3, 0.3])
    fullest = take_fullest(shares, places, 1)
    np.testing.assert_allclose(fullest, [[0.35, 0.3, 0.3]])
    assert len(take_fullest(shares, places, 8)) == 3  # empty cells are none
