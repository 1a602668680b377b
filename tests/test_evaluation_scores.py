"""The metrics of a whole test set against loops and scipy."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from dpc_jax.evaluation.alignment import identity_alignment
from dpc_jax.evaluation.density import densify
from dpc_jax.evaluation.scores import score

FRAME = Rotation.random(random_state=4)
ALIGNMENT = identity_alignment()._replace(rotation=FRAME.as_quat(scalar_first=True))


def scene(models=3, views=4, errors_deg=(0.0, 10.0, 100.0, 180.0)):
    """Poses that are wrong by known angles, and noisy shapes, in a turned frame."""
    rng = np.random.default_rng(0)
    shape = (models, views)
    truth = Rotation.random(models * views, random_state=1)
    axis = rng.normal(size=(models * views, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.radians(np.resize(errors_deg, models * views))[:, None]
    predicted = Rotation.from_rotvec(angle * axis) * truth * FRAME
    surfaces = rng.uniform(-0.5, 0.5, (models, 200, 3))
    objects = surfaces[:, None, :80] + 0.02 * rng.normal(size=(*shape, 80, 3))
    points = FRAME.inv().apply(objects.reshape(-1, 3)).reshape(objects.shape)
    to_array = [
        r.as_quat(scalar_first=True).reshape(*shape, 4) for r in (predicted, truth)
    ]
    return *to_array, points, surfaces, objects


def test_poses_and_shapes_are_scored_in_the_object_frame():
    predicted, truth, points, surfaces, objects = scene()
    got = score(predicted, truth, points, surfaces, alignment=ALIGNMENT)
    expected = np.tile([0.0, 10.0, 100.0, 180.0], (3, 1))
    # Angles through several float64 products; 2 atan2 keeps 1e-13 degrees per rounding.
    np.testing.assert_allclose(got.pose_errors_deg, expected, atol=1e-9)
    assert {type(value) for value in got.metrics.values()} == {float}
    assert got.best_candidate_errors_deg is None
    assert not any(name.startswith(("best", "dense")) for name in got.metrics)
    assert got.metrics["pose_accuracy"] == 0.5
    assert got.metrics["pose_median_error_deg"] == pytest.approx(55.0, abs=1e-9)
    assert got.metrics["flip_share"] == 0.25

    gaps = [
        [cdist(o, s) for o in views] for views, s in zip(objects, surfaces, strict=True)
    ]
    precision = 100 * np.mean([g.min(axis=1).mean() for views in gaps for g in views])
    coverage = 100 * np.mean([g.min(axis=0).mean() for views in gaps for g in views])
    assert got.metrics["precision"] == pytest.approx(
        precision, rel=1e-10
    )  # float64 sums
    assert got.metrics["coverage"] == pytest.approx(coverage, rel=1e-10)
    assert got.metrics["chamfer"] == pytest.approx(precision + coverage, rel=1e-10)


def test_dense_clouds_are_scored_beside_the_predicted_ones():
    predicted, truth, points, surfaces, objects = scene()
    plain = score(predicted, truth, points, surfaces, alignment=ALIGNMENT)
    got = score(
        predicted, truth, points, surfaces, alignment=ALIGNMENT, dense_points=300
    )
    assert {n: got.metrics[n] for n in plain.metrics} == plain.metrics
    few = score(
        predicted, truth, points, surfaces, alignment=ALIGNMENT, dense_points=80
    )
    assert few.metrics == plain.metrics  # they are dense already
    dense = [
        cdist(densify(o, 300), s)
        for views, s in zip(objects, surfaces, strict=True)
        for o in views
    ]
    precision = 100 * np.mean([d.min(axis=1).mean() for d in dense])
    coverage = 100 * np.mean([d.min(axis=0).mean() for d in dense])
    # The frame turns the points before they are made denser, with float64 rounding.
    assert got.metrics["dense_precision"] == pytest.approx(precision, rel=1e-9)
    assert got.metrics["dense_coverage"] == pytest.approx(coverage, rel=1e-9)
    assert got.metrics["dense_chamfer"] == pytest.approx(precision + coverage, rel=1e-9)
    assert got.metrics["dense_coverage"] < plain.metrics["coverage"]


def test_the_best_candidate_is_scored_apart_from_the_student():
    predicted, truth, points, surfaces, _ = scene()
    best = (
        Rotation.from_quat(truth.reshape(-1, 4), scalar_first=True) * FRAME
    ).as_quat(scalar_first=True)
    got = score(
        predicted,
        truth,
        points,
        surfaces,
        alignment=ALIGNMENT,
        best_candidate_poses=-best.reshape(truth.shape),
    )
    assert got.metrics["best_candidate_pose_accuracy"] == 1.0
    assert got.metrics["best_candidate_pose_median_error_deg"] < 1e-9
    assert got.metrics["pose_accuracy"] == 0.5


def test_fewer_views_may_be_compared_and_surfaces_may_differ_in_size():
    predicted, truth, points, surfaces, _ = scene()
    ragged = [surfaces[0], surfaces[1][:150], surfaces[2][:99]]
    got = score(predicted, truth, points, ragged, alignment=ALIGNMENT, chamfer_views=2)
    assert got.chamfers.shape == (3, 2, 2)
    assert got.pose_errors_deg.shape == (3, 4)


def test_a_diverged_network_is_named_not_averaged():
    predicted, truth, points, surfaces, _ = scene()
    points[1, 2, 0] = np.nan
    with pytest.raises(ValueError, match="finite coordinates in predicted"):
        score(predicted, truth, points, surfaces, alignment=ALIGNMENT)


def test_arguments_that_do_not_fit_together_are_refused_in_a_sentence():
    predicted, truth, points, surfaces, _ = scene()
    with pytest.raises(ValueError, match="2 surfaces"):
        score(predicted, truth, points, surfaces[:2], alignment=ALIGNMENT)
    with pytest.raises(ValueError, match="chamfer_views must be between 1 and 4"):
        score(predicted, truth, points, surfaces, alignment=ALIGNMENT, chamfer_views=5)


def test_given_poses_are_not_scored_but_the_shapes_are():
    predicted, truth, points, surfaces, _ = scene()
    whole = score(predicted, truth, points, surfaces, alignment=ALIGNMENT)
    given = score(None, truth, points, surfaces, alignment=ALIGNMENT)
    assert set(given.metrics) == {"chamfer", "precision", "coverage"}
    assert given.metrics["chamfer"] == whole.metrics["chamfer"]
    assert given.pose_errors_deg is None and given.best_candidate_errors_deg is None


def test_what_can_be_seen_of_a_surface_is_scored_apart():
    predicted, truth, points, surfaces, objects = scene()
    rng = np.random.default_rng(3)
    seen = [rng.uniform(size=len(surface)) < 0.5 for surface in surfaces]
    seen[1][:] = False  # as a whole
    got = score(predicted, truth, points, surfaces, alignment=ALIGNMENT, seen=seen)
    plain = score(predicted, truth, points, surfaces, alignment=ALIGNMENT)
    assert {n: got.metrics[n] for n in plain.metrics} == plain.metrics
    assert not any("visible" in name for name in plain.metrics)
    expected = []
    for model, (surface, part) in enumerate(zip(surfaces, seen, strict=True)):
        surface = np.asarray(surface)
        part = surface[part] if part.any() else surface
        for cloud in objects[model]:
            away = cdist(cloud, part)
            expected.append([away.min(axis=1).mean(), away.min(axis=0).mean()])
    precision, coverage = 100 * np.mean(expected, axis=0)
    assert got.metrics["visible_precision"] == pytest.approx(precision)
    assert got.metrics["visible_coverage"] == pytest.approx(coverage)
    assert got.metrics["visible_chamfer"] == pytest.approx(precision + coverage)
    with pytest.raises(ValueError, match="Expected a boolean for each of the"):
        score(
            predicted, truth, points, surfaces, alignment=ALIGNMENT, seen=[[True]] * 9
        )
