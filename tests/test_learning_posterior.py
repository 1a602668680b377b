"""Predicted poses: the student's, or those that the image's silhouette speaks for."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import (
    draw_mask,
    make_dataset,
    make_network,
    make_state,
    random_quaternions,
    tiny_config,
)

from dpc_jax.config import replace_fields
from dpc_jax.learning.inference import explanation as explanation_module
from dpc_jax.learning.inference import predictor as predictor_module
from dpc_jax.learning.inference.explanation import (
    FINALISTS,
    compare_poses,
    find_posteriors,
    rank_finely,
)
from dpc_jax.learning.inference.predictor import make_predictor, predict_all

SELECTING = tiny_config(student="posterior", flips=True, head="viewpoint")


def test_the_posterior_weighs_what_the_student_thinks_against_what_the_image_shows():
    chances = jnp.array([0.70, 0.29, 0.01, 0.0])
    # Equal fits: the student decides. One unit of loss is a factor e.
    for losses, chosen in (
        ([5.0, 5.0, 5.0, 5.0], 0),
        ([5.0, 4.2, 5.0, 5.0], 0),
        ([5.0, 4.0, 5.0, 5.0], 1),
        ([9.0, 8.0, 3.0, 5.0], 2),
        ([200.0, 200.0, 200.0, 1.0], 3),
    ):
        assert int(jnp.argmax(find_posteriors(jnp.array(losses), chances))) == chosen


def test_a_chance_of_nothing_is_finite_and_no_candidate_is_lost_to_it():
    chances = jnp.array([1.0, 0.0])
    assert int(jnp.argmax(find_posteriors(jnp.array([0.0, 1e-3]), chances))) == 0
    assert int(jnp.argmax(find_posteriors(jnp.array([1e4, 1e4]), jnp.zeros(2)))) == 0


FINE = replace_fields(SELECTING, {"render": {"fine_grid": 16}})  # twice the base


def make_scene(count=40):
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.4, 0.4, (count, 3)).astype(np.float32)
    return {"points": jnp.array(points), "mass": jnp.array(2.0), "sigma": 0.6}


def test_the_likeliest_few_are_compared_in_the_finest_grid():
    """As with that grid for the base, and sizes scaled."""
    scene, target = make_scene(), draw_mask(make_scene()["points"], [1, 0, 0, 0])
    target = jnp.array(target / 255.0, jnp.float32)
    candidates = jnp.array(random_quaternions(3, 9), jnp.float32)
    losses = jnp.array([3.0, 2.2, 2.0, 9.0, 1.5, 9.0, 9.0, 2.5, 9.0])
    chances = jnp.full(9, 1 / 9)
    best = jnp.argsort(losses)[:FINALISTS]
    base = replace_fields(FINE, {"render": {"grid": 16, "fine_grid": 0}})
    # Twice as many voxels along an axis: sigma doubles; peaks stay as high.
    twice = {**scene, "sigma": 1.2, "mass": scene["mass"] * 8}
    finer = compare_poses(twice, candidates[best], target, {}, config=base)
    found = rank_finely(scene, candidates, losses, chances, target, {}, config=FINE)
    assert found.tolist() == best[jnp.argsort(finer)].tolist()
    assert int(found[0]) != int(jnp.argmin(losses))


def test_what_the_student_thinks_counts_in_the_finest_grid_and_others_are_left_out(
    monkeypatch,
):
    def compare(scene, candidates, *_, **__):
        return candidates[:, 0]

    monkeypatch.setattr(explanation_module, "compare_candidates", compare)
    fine = jnp.array([5.0, 4.6, 5.0, 5.0, 0.0, 0.0])
    candidates = jnp.stack([fine] * 4, axis=1)
    chances = jnp.array([0.5, 0.3, 0.1, 0.06, 0.02, 0.02])
    for losses, chosen in (([9.0] * 4 + [99.0] * 2, 0), ([9.0, 9, 9, 99, 9, 99], 4)):
        found = rank_finely(
            make_scene(),
            candidates,
            jnp.array(losses),
            chances,
            jnp.zeros((16, 16)),
            {},
            config=FINE,
        )
        assert int(found[0]) == chosen
    plain = rank_finely(
        make_scene(),
        candidates,
        jnp.array([9.0, 9, 9, 9, 0, 9]),
        chances,
        jnp.zeros((8, 8)),
        {},
        config=SELECTING,
    )
    assert int(plain[0]) == 4  # without a finer grid the base grid decides


def predict(how):
    config = replace_fields(SELECTING, {"pose": {"student": how}})
    network = make_network(config)
    predictor = make_predictor(network, config, keeps_candidates=True)
    dataset = make_dataset(models=3, views=2)
    return predict_all(predictor, make_state(network, config), dataset)


@pytest.mark.usefixtures("quickly")
def test_predictions_take_the_candidate_of_the_largest_posterior(monkeypatch):
    def compare(scene, candidates, *_, **__):
        return 100.0 - 50.0 * jnp.arange(len(candidates)) / (len(candidates) - 1)

    monkeypatch.setattr(predictor_module, "compare_candidates", compare)
    monkeypatch.setattr(
        predictor_module, "search_nearby", lambda scene, pose, *_, **__: pose
    )
    student, posterior = predict("selects"), predict("posterior")
    candidates = np.asarray(student.candidates)
    chances = np.asarray(student.probabilities)
    picked = np.take_along_axis(candidates, chances.argmax(-1)[..., None, None], axis=2)
    assert np.allclose(student.poses, picked[:, :, 0], atol=1e-6)
    # The last one fits best, by more than this student's chances differ.
    assert np.allclose(posterior.poses, candidates[:, :, -1], atol=1e-5)
    assert (np.asarray(posterior.winners) == candidates.shape[2] - 1).all()
    # All else but what is seen from the pose is the same.
    for name in ("points", "candidates", "candidate_poses", "winners", "probabilities"):
        found = (np.asarray(getattr(p, name)) for p in (student, posterior))
        assert np.allclose(*found, atol=1e-5), name
    moved = np.abs(student.poses - posterior.poses).max(axis=-1) > 1e-3
    changed = np.abs(student.silhouettes - posterior.silhouettes).max(axis=(2, 3))
    assert moved.any() and ((changed > 1e-4) == moved).all()


def test_where_nothing_is_chosen_the_fit_is_not_weighed():
    for changes in ({"source": "given"}, {"candidates": 1}, {"student": "regresses"}):
        pose = dataclasses.replace(SELECTING.pose, **changes)
        assert not pose.weighs_fit
    assert SELECTING.pose.weighs_fit
