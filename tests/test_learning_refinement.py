"""Refinement: shapes through codes, poses freely, several views together."""

import jax.numpy as jnp
import numpy as np
import pytest
import tiny_runs

from dpc_jax.evaluation.rotations import angle_deg
from dpc_jax.learning.inference import refinement as refinement_module
from dpc_jax.learning.inference.codes import encode_all, find_directions, make_coder
from dpc_jax.learning.inference.explanation import FINALISTS
from dpc_jax.learning.inference.predictor import make_predictor, predict_all
from dpc_jax.learning.inference.refinement import (
    RefineSettings,
    make_refiner,
    refine_all,
)
from dpc_jax.run import refinement as run_refinement
from dpc_jax.run.refinement import join_views, measure_refinement, refine_objects

CONFIG = tiny_runs.tiny_config()


ALONE = [np.array([i]) for i in range(9)]
TOGETHER = [np.array([0, 1, 2]), np.array([3, 4, 5]), np.array([6, 7, 8])]


@pytest.fixture(autouse=True)
def quick_programs():
    """Each program here runs a few times only."""
    with tiny_runs.compiling_quickly():
        yield


@pytest.fixture(scope="module")
def run():
    """An untrained network, its codes of three objects in three views, directions."""
    network = tiny_runs.make_network(CONFIG)
    state = tiny_runs.make_state(network, CONFIG)
    dataset = tiny_runs.make_dataset()
    images = dataset.images.reshape(-1, *dataset.images.shape[2:])
    masks = dataset.masks.reshape(-1, *dataset.masks.shape[2:])
    found = encode_all(make_coder(network, CONFIG), state, images, masks)
    return network, state, dataset, found, masks, find_directions(found.codes)


def test_codes_are_what_the_network_predicts_from(run):
    """Without steps a single view is the plain prediction, up to rounding."""
    network, state, dataset, found, masks, _ = run
    plain = predict_all(make_predictor(network, CONFIG), state, dataset)
    evidence = join_views(found, masks, ALONE)
    joined = refine_objects(network, CONFIG, state, evidence, None)
    points = np.stack([one.points for one in joined])
    np.testing.assert_allclose(points, plain.points.reshape(points.shape), atol=1e-5)
    poses = np.stack([one.poses[0] for one in joined])
    assert angle_deg(poses, plain.poses.reshape(-1, 4)).max() < 0.1


@pytest.mark.parametrize("groups", [ALONE, TOGETHER], ids=["alone", "together"])
def test_refinement_begins_with_the_posterior_where_predictions_do(
    run, groups, monkeypatch
):
    """The first candidate fits best, by more than the student's chances differ."""

    def compare(scene, poses, *_, **__):
        return 100.0 * jnp.arange(len(poses))

    monkeypatch.setattr(refinement_module, "compare_candidates", compare)
    _, _, dataset, _, masks, _ = run
    config = tiny_runs.tiny_config(candidates=4, student="posterior")
    network = tiny_runs.make_network(config)
    state = tiny_runs.make_state(network, config)
    images = dataset.images.reshape(-1, *dataset.images.shape[2:])
    found = encode_all(make_coder(network, config), state, images, masks)
    evidence = join_views(found, masks, groups)
    joined = refine_objects(network, config, state, evidence, None)
    poses = np.concatenate([one.poses for one in joined])
    assert angle_deg(poses, found.candidates[:, 0]).max() < 0.1
    assert angle_deg(poses, found.poses).max() > 1  # of the student alone


def test_shapes_are_shown_and_refined_with_the_mass_that_training_renders_last(run):
    """Points twice as heavy, of which half are kept, look as all of these do."""
    _, _, dataset, _, masks, _ = run
    images = dataset.images.reshape(-1, *dataset.images.shape[2:])

    def show(**fields):
        config = tiny_runs.tiny_config(**fields)
        network = tiny_runs.make_network(config)
        state = tiny_runs.make_state(network, config)
        found = encode_all(make_coder(network, config), state, images, masks)
        evidence = join_views(found, masks, ALONE)
        predicted = predict_all(make_predictor(network, config), state, dataset)
        refined = refine_objects(network, config, state, evidence, None)
        shown = np.concatenate([one.silhouettes for one in refined])
        return predicted.silhouettes.reshape(shown.shape), shown, predicted.costs

    all_of_them = show(scale_fixed=0.2, keep_end=1.0)
    half = show(scale_fixed=0.4, keep_end=0.5)
    for one, other in zip(half, all_of_them, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)
    assert np.max(half[0]) > 0.1  # there is something to see


def test_refinement_lowers_the_error_of_silhouettes(run):
    network, state, _, found, masks, directions = run
    evidence = join_views(found, masks, TOGETHER)
    refined = refine_objects(network, CONFIG, state, evidence, directions)
    for one in refined:
        assert one.errors.mean() < one.errors_before.mean()
        assert one.poses.shape == (3, 4) and one.silhouettes.shape[0] == 3
    # Both the shape and the poses have moved.
    plain = refine_objects(network, CONFIG, state, evidence, None)
    assert np.abs(refined[0].points - plain[0].points).max() > 1e-4
    assert angle_deg(refined[0].poses, plain[0].poses).max() > 0.1


def test_a_view_that_fills_up_changes_nothing(run):
    """Three views are padded to four: the last one's weight is zero."""
    network, state, _, found, masks, directions = run
    evidence = join_views(found, masks, TOGETHER)
    assert evidence.weights.tolist() == 3 * [[1, 1, 1, 0]]
    refiner = make_refiner(network, CONFIG, RefineSettings(is_rechosen=True))
    first = refine_all(refiner, state, evidence, directions)
    other = evidence.masks.copy()
    other[:, 3] = 255 - other[:, 3]
    second = refine_all(refiner, state, evidence._replace(masks=other), directions)
    np.testing.assert_array_equal(first["points"], second["points"])
    np.testing.assert_array_equal(first["errors"][:, :3], second["errors"][:, :3])


def test_shapes_move_along_the_directions_alone(run):
    network, state, _, found, masks, directions = run
    evidence = join_views(found, masks, ALONE)
    still = refine_objects(network, CONFIG, state, evidence, 0 * directions)
    plain = refine_objects(network, CONFIG, state, evidence, None)
    for one, other in zip(still, plain, strict=True):
        np.testing.assert_allclose(one.points, other.points, atol=1e-6)
    turned = [
        angle_deg(one.poses, other.poses).max()
        for one, other in zip(still, plain, strict=True)
    ]
    assert max(turned) > 0.1


def test_directions_are_the_deviations_of_codes():
    """Of normal codes the longest direction is the axis that varies most."""
    rng = np.random.default_rng(0)
    codes = rng.normal(size=(4000, 3)) * [1.0, 5.0, 0.2] + 7
    directions = find_directions(codes)
    # The deviation of 4000 draws is known to about 1 %, with some margin.
    lengths = np.linalg.norm(directions, axis=1)
    np.testing.assert_allclose(lengths, [5, 1, 0.2], rtol=0.05)
    assert abs(directions[0] @ [0, 1, 0]) > 4.7
    with pytest.raises(ValueError, match="at least two views"):
        find_directions(codes[:1])


def test_figures_of_refinement_stand_beside_the_plain_ones(run):
    network, state, dataset, *_ = run
    from dpc_jax.evaluation.alignment import identity_alignment

    sets = {"val": dataset, "test": dataset}
    figures = measure_refinement(network, CONFIG, state, sets, identity_alignment())
    for start in ("refined_", "joined_", "refined_joined_"):
        assert figures[f"{start}chamfer"] > 0
        assert 0 <= figures[f"{start}pose_accuracy"] <= 1
    refined, joined = (
        figures[f"{start}joined_silhouette_error"] for start in ("refined_", "")
    )
    assert refined < joined


@pytest.fixture(scope="module")
def selecting():
    """Of a network that sees masks: six candidates, learned colours, a finer grid."""
    config = tiny_runs.tiny_config(
        candidates=6,
        student="posterior",
        fine_grid=16,
        sees_mask=True,
        color_weight=1.0,
        colors_move_points=False,
    )
    network = tiny_runs.make_network(config)
    # Points have the size that the schedule ends with, as in images that are shown.
    state = tiny_runs.make_state(network, config)
    state = state._replace(step=jnp.asarray(config.train.steps, jnp.int32))
    dataset = tiny_runs.make_dataset()
    images = dataset.images.reshape(-1, *dataset.images.shape[2:])
    masks = dataset.masks.reshape(-1, *dataset.masks.shape[2:])
    found = encode_all(make_coder(network, config), state, images, masks)
    return config, network, state, dataset, found, masks


def test_refinement_begins_with_what_is_predicted_in_the_finest_grid(selecting):
    """Poses, points and colours, whose tint is no part of the code that is bent."""
    config, network, state, dataset, found, masks = selecting
    plain = predict_all(make_predictor(network, config), state, dataset)
    evidence = join_views(found, masks, ALONE)
    joined = refine_objects(network, config, state, evidence, None)
    for name in ("points", "colors"):
        begun = np.stack([getattr(one, name) for one in joined])
        np.testing.assert_allclose(
            begun, getattr(plain, name).reshape(begun.shape), atol=1e-5
        )
    poses = np.stack([one.poses[0] for one in joined])
    assert angle_deg(poses, plain.poses.reshape(-1, 4)).max() < 0.1
    refined = refine_objects(
        network, config, state, evidence, find_directions(found.codes)
    )
    before = np.concatenate([one.errors_before for one in refined])
    shown = plain.silhouettes.reshape(-1, 16, 16)
    true = np.asarray(masks, np.float64) / 255
    np.testing.assert_allclose(
        before, ((shown - true) ** 2).mean(axis=(1, 2)), rtol=1e-3
    )


def test_of_the_likeliest_candidates_of_a_view_the_one_that_needs_least_bending_stays(
    selecting,
):
    """As if each had been refined alone."""
    config, network, state, dataset, found, masks = selecting
    evidence, directions = join_views(found, masks, ALONE), find_directions(found.codes)

    def refine(evidence, **changes):
        settings = RefineSettings(steps=5, pose_pull=0.0, code_pull=0.0, **changes)
        refiner = make_refiner(network, config, settings)
        return refine_all(refiner, state, evidence, directions)

    each = [
        refine(evidence._replace(poses=found.candidates[:, None, i])) for i in range(6)
    ]
    errors = np.stack([one["errors"][:, 0] for one in each], axis=1)
    likeliest = refine(evidence, is_rechosen=True)
    both, four = refine(evidence, hypotheses=2), refine(evidence, hypotheses=4)
    np.testing.assert_allclose(
        both["errors_before"], likeliest["errors_before"], rtol=1e-5
    )
    taken = []
    for i in range(9):
        ranks = [np.abs(errors[i] - x["errors"][i]).argmin() for x in (both, four)]
        for rank, result in zip(ranks, (both, four), strict=True):
            for name in ("points", "poses", "silhouettes", "errors", "colors"):
                np.testing.assert_allclose(
                    result[name][i], each[rank][name][i], atol=2e-4, err_msg=name
                )
        assert errors[i][ranks[1]] <= errors[i][ranks[0]] + 1e-6
        assert errors[i][ranks[0]] <= likeliest["errors"][i, 0] + 1e-6
        # Two of six are left out: that of the least error may be one of them.
        assert (errors[i] < errors[i][ranks[1]] - 1e-6).sum() <= 2
        taken.append(ranks)
    assert len({two for two, _ in taken}) > 1


def test_single_views_are_refined_from_several_candidates_and_objects_from_one(
    selecting, monkeypatch
):
    config, network, state, dataset, found, masks = selecting
    asked = []

    def make(network, config, settings):
        asked.append((settings.hypotheses, settings.is_rechosen))
        raise KeyboardInterrupt

    monkeypatch.setattr(run_refinement, "make_refiner", make)
    directions = find_directions(found.codes)
    for groups in (ALONE, TOGETHER):
        for how in (directions, None):
            with pytest.raises(KeyboardInterrupt):
                refine_objects(
                    network, config, state, join_views(found, masks, groups), how
                )
    assert asked == [(FINALISTS, True), (1, True), (1, True), (1, True)]
