"""The training shape that is nearest to a shape."""

import numpy as np
import pytest

from dpc_jax.evaluation.chamfer import chamfer_distance
from dpc_jax.evaluation.training_shapes import ShapeIndex, spread_rows


def make_boxes(count, seed=0, points=800):
    rng = np.random.default_rng(seed)
    sides = rng.uniform(0.1, 0.6, (count, 1, 3))
    return sides * rng.uniform(-0.5, 0.5, (count, points, 3))


def test_a_training_shape_is_found_by_other_points_of_it():
    boxes = make_boxes(60)
    index = ShapeIndex(boxes[:, :400])
    for number in (0, 17, 59):
        assert index.find_nearest(boxes[number, 400:]) == number


def test_the_shortlist_loses_little_against_comparing_all():
    boxes, others = make_boxes(80, points=500), make_boxes(6, seed=1, points=500)
    index = ShapeIndex(boxes)
    excess = []
    for other in others:
        found = chamfer_distance(boxes[index.find_nearest(other)], other).chamfer
        best = min(chamfer_distance(box, other).chamfer for box in boxes)
        excess.append(found / best - 1)
    # Sampling noise of 500 points decides between shapes that are nearly as near.
    assert np.mean(excess) < 0.02 and max(excess) < 0.1


@pytest.mark.parametrize(
    ("count", "rows"), [(3, [0, 4, 9]), (10, range(10)), (19, [*range(10)])]
)
def test_rows_are_spread_over_all_and_repeated_where_there_are_few(count, rows):
    points = np.arange(30.0).reshape(10, 3)
    found = spread_rows(points, count)
    assert len(found) == count
    np.testing.assert_array_equal(np.unique(found, axis=0), points[list(rows)])
