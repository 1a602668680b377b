"""What a report shows of a run: which views, beside which shapes."""

import numpy as np
import pytest
from tiny_runs import make_dataset, random_quaternions, tiny_config

from dpc_jax.data.arrays import VISIBLE_STEPS
from dpc_jax.evaluation import chamfer_distance
from dpc_jax.evaluation.alignment import identity_alignment
from dpc_jax.learning.inference import evaluator
from dpc_jax.learning.inference.predictor import Predictions
from dpc_jax.run.report.shown_views import Judged, choose_examples, choose_views
from dpc_jax.run.report.summary import list_warnings, measure_gains
from dpc_jax.run.report.training_shapes import (
    REFERENCES,
    TrainingShapes,
    average_surfaces,
    coarsen,
    find_nearest,
    take_fullest,
)


def test_worst_median_and_best_are_of_different_objects_and_no_view_comes_twice():
    badness = np.arange(20.0).reshape(5, 4)
    models = np.repeat(np.arange(5), 4).reshape(5, 4)
    chosen = choose_views(badness, models, per_group=2)
    assert chosen == [
        ("Worst", 4, 3),
        ("Worst", 3, 3),
        ("Median", 2, 1),
        ("Median", 1, 3),  # of another object than those that are nearer to the middle
        ("Best", 0, 0),
        ("Best", 1, 0),
    ]


@pytest.mark.parametrize("views", [1, 5])
def test_with_few_views_each_group_has_some_of_them(views):
    badness = np.arange(float(views))[None]
    chosen = choose_views(badness, np.zeros((1, views), int), per_group=3)
    assert len(chosen) == min(3, views)
    assert {group for group, _, _ in chosen} == {"Worst", "Median", "Best"} or views < 3


def predict_truth(dataset):
    """Predictions that are the truth, but for every other view, which is turned."""
    poses = np.array(dataset.quaternions, np.float64)
    poses[:, 1] = random_quaternions(0, len(poses))
    count, views = poses.shape[:2]
    points = np.repeat(np.asarray(dataset.surfaces)[:, None], views, axis=1)
    silhouettes = dataset.masks.reshape(count, views, 8, 2, 8, 2).mean((3, 5)) / 255
    return Predictions(
        points=points,
        poses=poses,
        winners=np.zeros((count, views), int),
        silhouettes=silhouettes,
        candidates=poses[:, :, None],
        probabilities=np.ones((count, views, 1)),
        losses=np.zeros((count, views, 1)),
        codes=np.zeros((count, views, 1)),
    )


@pytest.fixture(scope="module")
def sets():
    names = ("train", "val", "test")
    found = {n: make_dataset(models=6, seed=i) for i, n in enumerate(names)}
    # Of the test objects the first is a training object too.
    surfaces = np.array(found["test"].surfaces)
    surfaces[0] = found["train"].surfaces[4]
    return found | {"test": found["test"]._replace(surfaces=surfaces)}


def show(sets, **changes):
    test = sets["test"]._replace(**changes)
    predictions = predict_truth(sets["test"])
    result = evaluator.score(predictions, test, alignment=identity_alignment())
    shapes = TrainingShapes.gather(sets | {"test": test}, 60)
    judged = Judged(predictions, test, identity_alignment(), result, 2.0)
    examples, ranking = choose_examples(judged, per_group=3, shapes=shapes)
    return judged, shapes, examples, ranking


def test_views_are_ranked_by_what_is_known_of_them(sets):
    *_, examples, ranking = show(sets)
    assert "pose error" in ranking
    errors = [e.pose_error_deg for e in examples]
    assert min(errors[:3]) > max(errors[-3:])
    assert all(e.chamfer == 0 and 0 < e.overlap <= 1 for e in examples)
    *_, examples, ranking = show(sets, quaternions=None, surfaces=None)
    assert "overlap of silhouettes" in ranking
    overlaps = [e.overlap for e in examples]
    assert max(overlaps[:3]) <= min(overlaps[-3:])
    assert all(e.pose_error_deg is e.chamfer is e.surface is None for e in examples)
    assert all(e.neighbours == () for e in examples)


def test_neighbours_are_training_shapes_and_a_copy_is_seen_as_one(sets):
    judged, shapes, examples, _ = show(sets)
    near, mean = examples[0].neighbours
    assert near.title == "Nearest training shape" and near.chamfer < mean.chamfer
    np.testing.assert_array_equal(
        shapes.find_nearest(np.asarray(judged.dataset.surfaces[0]), 60),
        sets["train"].surfaces[4],
    )


def test_references_are_distances_of_clouds_that_see_no_image(sets):
    shown = {}
    for name, data in sets.items():
        half = np.asarray(data.surfaces)[:, ::2]
        steps = np.round((half + 0.5) * VISIBLE_STEPS).astype(np.uint16)
        shown[name] = data._replace(visible=steps)
    shapes = TrainingShapes.gather(shown, 60)
    predictions, frame = predict_truth(sets["test"]), identity_alignment()
    found = shapes.measure_references(predictions, shown["test"], frame)
    assert set(found) == {
        f"{prefix}{name}_chamfer" for prefix in ("", "visible_") for name in REFERENCES
    }

    def average(guess, read):
        truths = [read(model) for model in range(6)]
        return 100 * np.mean([chamfer_distance(guess(t), t).chamfer for t in truths])

    whole, read = sets["test"].surfaces.__getitem__, shown["test"].read_visible
    expected = {
        "mean_shape_chamfer": average(lambda _: shapes.means[""], whole),
        "visible_mean_shape_chamfer": average(lambda _: shapes.means["visible_"], read),
        "nearest_shape_chamfer": average(lambda t: shapes.find_nearest(t, 60), whole),
    }
    assert {n: found[n] for n in expected} == pytest.approx(expected)
    assert found["floor_chamfer"] > 0
    metrics = {"floor_chamfer": 2.0, "mean_shape_chamfer": 4.0, "chamfer": 3.5}
    assert measure_gains(metrics) == {"chamfer_gain": 0.25}
    # Without what is visible the others are the same.
    plain = TrainingShapes.gather(sets, 60)
    assert plain.measure_references(predictions, sets["test"], frame) == {
        name: value for name, value in found.items() if not name.startswith("visible_")
    }


def test_what_was_skipped_is_counted_and_named():
    sets = {
        "test": make_dataset(models=1)._replace(skipped=(("car-0", "it is empty"),))
    }
    (warning,) = list_warnings(tiny_config(), sets, None)
    assert warning == "Models skipped: 1 (car-0: it is empty)."


# The training shape that is nearest to a shape, and the mean one.


def make_boxes(count, seed=0):
    rng = np.random.default_rng(seed)
    sides = rng.uniform(0.1, 0.6, (count, 1, 3))
    return sides * rng.uniform(-0.5, 0.5, (count, 500, 3))


def test_the_shortlist_loses_little_against_comparing_all():
    boxes, others = make_boxes(80), make_boxes(6, seed=1)
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
