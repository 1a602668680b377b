"""Poses from labels, shapes with the labels' poses; given poses are not scored."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import (
    copy,
    make_batch,
    make_dataset,
    make_network,
    make_recipe,
    make_state,
    make_step,
    random_quaternions,
    tiny_config,
)

from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import identity_alignment
from dpc_jax.learning.inference import evaluator
from dpc_jax.learning.inference.predictor import Predictions
from dpc_jax.learning.poses.labels import compare_labels
from dpc_jax.learning.poses.teaching import compare_student
from dpc_jax.learning.predictions import Poses
from dpc_jax.run.report.summary import list_warnings

pytestmark = pytest.mark.usefixtures("quickly")

CONFIG = tiny_config(
    source="labels", student="posterior", candidates=3, student_weight=0.05
)


def compare(candidates, labels):
    poses = Poses(candidates, None, jnp.zeros(candidates.shape[:2]))
    return compare_labels(poses, labels, recipe=make_recipe(CONFIG))


def angle(first, second):
    """In radians, by the trace of the relative rotation, in float64."""
    cosine = abs(first @ second) / np.linalg.norm(first) / np.linalg.norm(second)
    return 2 * np.arccos(min(1.0, cosine))


def test_of_each_view_the_candidate_nearest_to_the_label_learns():
    candidates, labels = random_quaternions(0, 4, 3), random_quaternions(1, 2, 2)
    winners, terms = compare(jnp.asarray(candidates), jnp.asarray(labels))
    targets = labels.reshape(4, 4)
    angles = np.array(
        [[angle(candidates[i, k], targets[i]) for k in range(3)] for i in range(4)]
    )
    np.testing.assert_array_equal(winners.indices.ravel(), angles.argmin(1))
    np.testing.assert_array_equal(winners.poses, labels.astype(np.float32))
    loss, weight = terms["labels"]
    assert float(loss) == pytest.approx(angles.min(1).mean(), rel=1e-5)  # float32
    assert weight == 0.05 * CONFIG.render.grid**2

    gradient = jax.grad(lambda c: compare(c, jnp.asarray(labels))[1]["labels"].value)(
        jnp.asarray(candidates)
    )
    learns = np.abs(gradient).max(-1) > 0
    np.testing.assert_array_equal(learns, np.eye(3, dtype=bool)[angles.argmin(1)])


def test_the_sign_of_a_label_changes_nothing():
    candidates, labels = random_quaternions(0, 4, 3), random_quaternions(1, 2, 2)
    first, second = (
        compare(jnp.asarray(candidates), jnp.asarray(sign * labels)) for sign in (1, -1)
    )
    np.testing.assert_array_equal(first[0].indices, second[0].indices)
    assert float(first[1]["labels"].value) == pytest.approx(
        float(second[1]["labels"].value), rel=1e-6
    )


def test_the_student_selects_the_candidate_nearest_to_the_label():
    candidates, labels = random_quaternions(0, 4, 3), random_quaternions(1, 2, 2)
    logits = jnp.asarray(np.random.default_rng(2).normal(size=(4, 3)))
    poses = Poses(jnp.asarray(candidates), None, logits)
    winners, _ = compare_labels(poses, jnp.asarray(labels), recipe=make_recipe(CONFIG))
    terms = compare_student(poses, winners, recipe=make_recipe(CONFIG))
    chosen = jax.nn.log_softmax(logits)[jnp.arange(4), winners.indices.ravel()]
    assert float(terms["student"].value) == pytest.approx(
        -float(chosen.mean()), rel=1e-5
    )


@pytest.fixture(scope="module")
def trained():
    """(first metrics, last metrics, metrics of the first step with turned labels)."""
    network = make_network(CONFIG)
    state, step, batch = (
        make_state(network, CONFIG),
        make_step(network, CONFIG),
        make_batch(),
    )
    turned = batch | {"quaternions": random_quaternions(9, 2, 2).astype(np.float32)}
    _, other = step(copy(state), turned)
    records = []
    for _ in range(60):
        state, metrics = step(state, batch)
        records.append(jax.device_get(metrics))
    return records[0], records[-1], jax.device_get(other)


def test_poses_are_learned_from_labels_in_a_few_steps(trained):
    first, last, _ = trained
    assert last["labels"] < 0.5 * first["labels"]
    assert last["student"] < first["student"]


def test_the_shape_is_learned_with_the_poses_of_the_labels(trained):
    first, last, other = trained
    assert other["reprojection"] != first["reprojection"]
    assert last["reprojection"] < first["reprojection"]


def predict_truth(dataset: DataSet) -> Predictions:
    """Predictions that repeat the given poses."""
    poses = np.asarray(dataset.quaternions)
    points = np.asarray(dataset.surfaces)[:, None].repeat(poses.shape[1], axis=1)
    sides = np.asarray(dataset.masks) / 255.0
    return Predictions(
        points=points,
        colors=None,
        poses=poses,
        candidate_poses=poses,
        winners=np.zeros(poses.shape[:2], int),
        silhouettes=sides,
    )


@pytest.mark.parametrize("poses_given", [False, True])
def test_poses_that_were_given_are_absent_from_the_scores(poses_given):
    dataset = make_dataset()
    result, _ = evaluator.score(
        predict_truth(dataset),
        dataset,
        alignment=identity_alignment(),
        heads=0,
        poses_given=poses_given,
    )
    assert result.metrics["chamfer"] == pytest.approx(0, abs=1e-6)
    has_poses = any("pose" in name for name in result.metrics)
    assert has_poses != poses_given
    assert (result.pose_errors_deg is None) == poses_given


@pytest.mark.parametrize("known", [False, True])
def test_a_report_says_that_the_figures_of_given_poses_are_absent(known):
    dataset = make_dataset()._replace(warnings=("The split is another one.",))
    sets = {"val": dataset, "test": dataset}
    warnings = list_warnings(
        tiny_config(source="given" if known else "unknown"), sets, None
    )
    assert warnings[0] == "The split is another one."
    assert any("absent" in text for text in warnings[1:]) == known
