"""Refinement: shapes through codes, poses freely, several views together."""

import jax.numpy as jnp
import numpy as np
import pytest
import tiny_runs

from dpc_jax.evaluation.rotations import rotation_angle_deg
from dpc_jax.learning.inference import refiner as refiner_module
from dpc_jax.learning.inference.predictor import make_predictor, predict_all
from dpc_jax.learning.inference.refiner import (
    find_directions,
    join_views,
    make_refiner,
    refine_objects,
)
from dpc_jax.learning.inference.search import FINALISTS

ALONE = [np.array([i]) for i in range(9)]
TOGETHER = [np.array([0, 1, 2]), np.array([3, 4, 5]), np.array([6, 7, 8])]


class Run:
    """An untrained network, and what it says of three objects in three views."""

    def __init__(self, **changes):
        self.config = tiny_runs.tiny_config(**changes)
        self.network = tiny_runs.make_network(self.config)
        # Points have the size that the schedule ends with, as in images that are shown.
        state = tiny_runs.make_state(self.network, self.config)
        last = jnp.asarray(self.config.train.steps, jnp.int32)
        self.state = state._replace(step=last)
        self.dataset = tiny_runs.make_dataset()
        self.masks = self.dataset.masks.reshape(-1, *self.dataset.masks.shape[2:])
        predictor = make_predictor(self.network, self.config)
        self.plain = predict_all(predictor, self.state, self.dataset)
        codes = self.plain.codes[..., : self.network.encoder.hidden]
        self.directions = find_directions(codes)
        self.refiner = make_refiner(self.network, self.config)

    def join(self, groups):
        return join_views(self.plain, self.masks, groups)

    def refine(self, groups, directions=None, *, refiner=None):
        """The objects; only joined without directions."""
        directions = self.directions[:0] if directions is None else directions
        evidence = groups if isinstance(groups, tuple) else self.join(groups)
        return refine_objects(refiner or self.refiner, self.state, evidence, directions)

    def list_plain(self, name):
        """What is predicted of each view."""
        array = getattr(self.plain, name)
        return array.reshape(-1, *array.shape[2:])


def gather(objects, name):
    return np.stack([one[name] for one in objects])


@pytest.fixture(scope="module")
def run():
    return Run()


@pytest.fixture(scope="module")
def selecting():
    """Of a network that sees masks: six candidates, learned colours, a finer grid."""
    changes = {"num_heads": 6, "student": "selects", "fine_grid": 16}
    changes |= {"sees_mask": True, "color_weight": 1.0, "colors_move_points": False}
    return Run(**changes)


def test_shapes_move_along_the_directions_alone(run):
    """Without any a single view is the plain prediction, up to rounding."""
    plain, still = run.refine(ALONE), run.refine(ALONE, 0 * run.directions)
    for name in ("points", "silhouettes"):
        found = gather(plain, name).reshape(run.list_plain(name).shape)
        np.testing.assert_allclose(found, run.list_plain(name), atol=1e-5)
    poses = gather(plain, "poses")[:, 0]
    assert rotation_angle_deg(poses, run.list_plain("poses")).max() < 0.1
    np.testing.assert_allclose(
        gather(still, "points"), gather(plain, "points"), atol=1e-6
    )
    assert rotation_angle_deg(gather(still, "poses")[:, 0], poses).max() > 0.1


def test_refinement_begins_with_what_is_predicted_in_the_finest_grid(selecting):
    """Poses, points and colours, whose tint is no part of the code that is bent."""
    joined = selecting.refine(ALONE)
    for name in ("points", "colors"):
        np.testing.assert_allclose(
            gather(joined, name), selecting.list_plain(name), atol=1e-5
        )
    poses = gather(joined, "poses")[:, 0]
    assert rotation_angle_deg(poses, selecting.list_plain("poses")).max() < 0.1
    refined = selecting.refine(ALONE, selecting.directions)
    true = np.asarray(selecting.masks, np.float64) / 255
    errors = (selecting.list_plain("silhouettes") - true) ** 2
    np.testing.assert_allclose(
        gather(refined, "errors")[:, 0, 0], errors.mean(axis=(1, 2)), rtol=1e-3
    )


def test_views_of_an_object_have_the_pose_that_their_shape_fits_best(
    selecting, monkeypatch
):
    """The first candidate fits best, by more than the student's chances differ."""

    def compare(scene, poses, *_, **__):  # behind the pose that is predicted
        return 100.0 * jnp.abs(jnp.arange(len(poses)) - 1)

    monkeypatch.setattr(refiner_module, "compare_poses", compare)
    monkeypatch.setattr("dpc_jax.learning.inference.search.FINALISTS", 1)
    refiner = make_refiner(selecting.network, selecting.config)
    joined = selecting.refine(TOGETHER, refiner=refiner)
    poses = np.concatenate([one["poses"] for one in joined])
    candidates = selecting.list_plain("candidates")
    assert rotation_angle_deg(poses, candidates[:, 0]).max() < 0.1
    assert rotation_angle_deg(poses, selecting.list_plain("poses")).max() > 1


@pytest.mark.slow
def test_shapes_are_shown_and_refined_with_the_mass_that_training_renders_last():
    """Points twice as heavy, of which half are kept, look as all of these do."""
    whole = Run(scale_fixed=0.2, keep_end=1.0)
    half = Run(scale_fixed=0.4, keep_end=0.5)
    shown = whole.list_plain("silhouettes")
    refined = gather(half.refine(ALONE), "silhouettes")[:, 0]
    for found in (half.list_plain("silhouettes"), refined):
        np.testing.assert_allclose(found, shown, rtol=1e-5, atol=1e-6)
    assert np.max(shown) > 0.1  # there is something to see


def test_refinement_lowers_the_error_of_silhouettes(run):
    refined, plain = run.refine(TOGETHER, run.directions), run.refine(TOGETHER)
    for one in refined:
        before, after = one["errors"]
        assert after.mean() < before.mean() and one["poses"].shape == (3, 4)
    # Both the shape and the poses have moved.
    assert np.abs(gather(refined, "points") - gather(plain, "points")).max() > 1e-4
    assert rotation_angle_deg(refined[0]["poses"], plain[0]["poses"]).max() > 0.1


def test_a_view_that_fills_up_changes_nothing(run):
    """Three views are padded to four: the last one's weight is zero."""
    evidence = run.join(TOGETHER)
    assert evidence.weights.tolist() == 3 * [[1, 1, 1, 0]]
    other = evidence.masks.copy()
    other[:, 3] = 255 - other[:, 3]
    first = run.refine(evidence, run.directions)
    second = run.refine(evidence._replace(masks=other), run.directions)
    for name in ("points", "errors"):
        np.testing.assert_array_equal(gather(first, name), gather(second, name))


def test_directions_are_the_deviations_of_codes():
    """Of normal codes the longest direction is the axis that varies most."""
    rng = np.random.default_rng(0)
    codes = rng.normal(size=(400, 10, 3)) * [1.0, 5.0, 0.2] + 7
    directions = find_directions(codes)
    # The deviation of 4000 draws is known to about 1 %, with some margin.
    lengths = np.linalg.norm(directions, axis=1)
    np.testing.assert_allclose(lengths, [5, 1, 0.2], rtol=0.05)
    assert abs(directions[0] @ [0, 1, 0]) > 4.7
    with pytest.raises(ValueError, match="at least two views"):
        find_directions(codes[:1, :1])


@pytest.mark.slow
def test_of_the_likeliest_candidates_of_a_view_the_one_that_needs_least_bending_stays(
    selecting, monkeypatch
):
    """As if each had been refined alone."""
    for name, value in (("STEPS", 5), ("POSE_PULL", 0.0), ("CODE_PULL", 0.0)):
        monkeypatch.setattr(refiner_module, name, value)
    evidence = selecting.join(ALONE)
    # Of drawn heads the predicted pose is taken as it is.
    trusting = tiny_runs.replace_fields(
        selecting.config, {"pose": {"source": "sampled"}}
    )
    alone = make_refiner(selecting.network, trusting)
    each = [
        selecting.refine(
            evidence._replace(poses=evidence.candidates[:, :, i]),
            selecting.directions,
            refiner=alone,
        )
        for i in range(6)
    ]
    errors = np.stack([gather(one, "errors")[:, :, 0] for one in each])  # [6, 9, 2]
    refiner = make_refiner(selecting.network, selecting.config)
    found = selecting.refine(evidence, selecting.directions, refiner=refiner)
    taken = []
    for i, one in enumerate(found):
        before, after = one["errors"][:, 0]
        first = np.abs(errors[:, i, 0] - before).argmin()  # the likeliest
        rank = np.abs(errors[:, i, 1] - after).argmin()
        for name in ("points", "poses", "silhouettes", "colors"):
            np.testing.assert_allclose(
                one[name], each[rank][i][name], atol=2e-4, err_msg=name
            )
        assert errors[rank, i, 1] <= errors[first, i, 1] + 1e-6
        # Of six some are left out: that of the least error may be one of them.
        is_less = errors[:, i, 1] < errors[rank, i, 1] - 1e-6
        assert is_less.sum() <= len(each) - FINALISTS
        taken.append(first == rank)
    assert not all(taken)
