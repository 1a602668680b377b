"""The metrics of a whole test set against loops and scipy."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from dpc_jax.evaluation.alignment import identity_alignment
from dpc_jax.evaluation.scores import Scores, estimate_errors, score

FRAME = Rotation.random(random_state=4)
ALIGNMENT = identity_alignment()._replace(rotation=FRAME.as_quat(scalar_first=True))


ERRORS_DEG = (0.0, 10.0, 100.0, 180.0)  # of the views of each object


@pytest.fixture(scope="module")
def given():
    """Poses that are wrong by these angles, and noisy shapes, in a turned frame."""
    rng = np.random.default_rng(0)
    truth = Rotation.random(12, random_state=1)
    axis = rng.normal(size=(12, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.radians(np.tile(ERRORS_DEG, 3))[:, None]
    predicted = Rotation.from_rotvec(angle * axis) * truth * FRAME
    surfaces = rng.uniform(-0.5, 0.5, (3, 200, 3))
    objects = surfaces[:, None, :80] + 0.02 * rng.normal(size=(3, 4, 80, 3))
    points = FRAME.inv().apply(objects.reshape(-1, 3)).reshape(objects.shape)
    poses = [r.as_quat(scalar_first=True).reshape(3, 4, 4) for r in (predicted, truth)]
    return *poses, points, surfaces, objects


def judge(given, **changes):
    """The scores of a scene, or of what replaces its arrays."""
    arrays = dict(
        zip(("predicted", "truth", "points", "surfaces"), given, strict=False)
    )
    arrays |= {name: changes.pop(name) for name in arrays if name in changes}
    return score(*arrays.values(), alignment=ALIGNMENT, **changes)


def measure_plainly(clouds, surfaces):
    """Chamfer distance, precision and coverage of clouds, each beside its surface."""
    gaps = [
        cdist(o, s) for views, s in zip(clouds, surfaces, strict=True) for o in views
    ]
    precision = 100 * np.mean([gap.min(axis=1).mean() for gap in gaps])
    coverage = 100 * np.mean([gap.min(axis=0).mean() for gap in gaps])
    return {
        "chamfer": precision + coverage,
        "precision": precision,
        "coverage": coverage,
    }


def pick(metrics, prefix=""):
    names = ("chamfer", "precision", "coverage")
    return {name: metrics[prefix + name] for name in names}


def test_poses_and_shapes_are_scored_in_the_object_frame(given):
    got = judge(given)
    expected = np.tile(ERRORS_DEG, (3, 1))
    # Angles through several float64 products; 2 atan2 keeps 1e-13 degrees per rounding.
    np.testing.assert_allclose(got.failures.errors_deg, expected, atol=1e-9)
    assert {type(value) for value in got.metrics.values()} == {float}
    assert not any(name.startswith("best") for name in got.metrics)
    assert got.metrics["pose_accuracy"] == 0.5
    assert got.metrics["pose_median_error_deg"] == pytest.approx(55.0, abs=1e-9)
    assert got.metrics["flip_share"] == 0.25
    *_, surfaces, objects = given
    plain = measure_plainly(objects, surfaces)
    assert pick(got.metrics) == pytest.approx(plain, rel=1e-10)  # float64 sums


def test_the_best_candidate_is_scored_apart_from_the_student(given):
    truth = given[1]
    best = Rotation.from_quat(truth.reshape(-1, 4), scalar_first=True) * FRAME
    best = -best.as_quat(scalar_first=True).reshape(truth.shape)
    got = judge(given, best_candidate_poses=best)
    assert got.metrics["best_candidate_pose_accuracy"] == 1.0
    assert got.metrics["best_candidate_pose_median_error_deg"] < 1e-9
    assert got.metrics["pose_accuracy"] == 0.5


def test_fewer_views_may_be_compared_and_surfaces_may_differ_in_size(given):
    surfaces = given[3]
    ragged = [surfaces[0], surfaces[1][:150], surfaces[2][:99]]
    got = judge(given, surfaces=ragged, chamfer_views=2)
    assert got.chamfers.shape == (3, 2, 2)


def test_given_poses_are_not_scored_but_the_shapes_are(given):
    whole, found = judge(given), judge(given, predicted=None)
    assert found.metrics == pick(whole.metrics) and found.failures is None


def test_what_can_be_seen_of_a_surface_is_scored_apart(given):
    *_, surfaces, objects = given
    parts = [surfaces[0][:90], surfaces[1], surfaces[2][7:]]
    got, plain = judge(given, visible=parts), judge(given)
    assert {n: got.metrics[n] for n in plain.metrics} == plain.metrics
    assert not any("visible" in name for name in plain.metrics)
    expected = measure_plainly(objects, parts)
    assert pick(got.metrics, "visible_") == pytest.approx(expected)


def test_errors_over_objects_are_those_of_means_of_independent_objects(given):
    scores = judge(given, visible=given[3])
    found = estimate_errors(scores)
    assert set(found) == {
        "pose_accuracy_stderr",
        "pose_median_error_deg_stderr",
        "chamfer_stderr",
        "visible_chamfer_stderr",
    }
    # All objects have the same errors, views apart.
    assert found["pose_accuracy_stderr"] == 0
    rng = np.random.default_rng(0)
    distances = np.repeat(rng.normal(size=(400, 1, 1)), 2, axis=2) / 200
    spread = estimate_errors(Scores({}, chamfers=np.repeat(distances, 5, axis=1)))
    # Of 1000 draws, a standard error of two per cent; views of an object are alike.
    assert spread["chamfer_stderr"] == pytest.approx(1 / np.sqrt(400), rel=0.15)
