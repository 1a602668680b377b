"""Hand-tuned against learned sizes: which runs are compared, and their figures."""

import json

import numpy as np
import pytest
from PIL import Image

from dpc_jax.config import Config, replace_fields, to_json
from dpc_jax.experiments import point_kinds, point_sizes
from dpc_jax.reporting.ellipsoids import DEVIATIONS, draw_ellipsoids
from dpc_jax.reporting.point_sizes import Gaussians


def make_run(folder, kind, count, *, error, validation=0.5, sigma_end=0.05, seed=0):
    """The files of a finished run that the figures read."""
    changes = {
        "network": {"point_size": kind},
        "render": {"num_points": count, "sigma_end": sigma_end},
        "pose": {"known": True},
    }
    (folder / "report").mkdir(parents=True)
    config = replace_fields(Config("chair", seed=seed), changes)
    (folder / "config.json").write_text(to_json(config))
    metrics = json.dumps({"projection_error": error})
    (folder / "report" / "metrics.json").write_text(metrics)
    lines = [{"step": 1}, {"step": 2, "projection_error": validation}]
    (folder / "metrics.jsonl").write_text("\n".join(map(json.dumps, lines)))
    return folder


def make_gaussians(run):
    rng = np.random.default_rng(0)
    return [
        Gaussians(
            image=rng.integers(0, 256, (16, 16, 3)).astype(np.uint8),
            target=rng.uniform(size=(16, 16)),
            predicted=rng.uniform(size=(32, 32)),
            points=rng.uniform(-0.3, 0.3, (5, 3)),
            covariances=np.tile(0.01 * np.eye(3), (5, 1, 1)),
        )
    ] * 2


def test_figures_show_the_hand_tuned_sigma_that_validation_chose(tmp_path, monkeypatch):
    monkeypatch.setattr(point_sizes, "predict_gaussians", make_gaussians)
    hand = [(0.05, 0.3, 0.1), (0.07, 0.2, 0.4), (0.1, 0.4, 0.05)]
    workdirs = [
        make_run(
            tmp_path / f"hand{end}",
            "",
            20,
            error=error,
            validation=validation,
            sigma_end=end,
        )
        for end, validation, error in hand
    ]
    for seed, error in ((0, 0.03), (1, 0.05)):
        workdirs.append(
            make_run(tmp_path / f"s{seed}", "sigma", 20, error=error, seed=seed)
        )
    workdirs.append(make_run(tmp_path / "c", "covariance", 20, error=0.02))
    workdirs.append(make_run(tmp_path / "c200", "covariance", 200, error=0.01))
    metrics, paths = point_sizes.draw(tmp_path / "out", workdirs)
    assert metrics == {
        "hand_tuned_sigma_20": 0.07,
        "projection_error_hand_tuned_20": 0.4,
        "projection_error_sigma_20": pytest.approx(0.04),
        "projection_error_covariance_20": 0.02,
        "projection_error_covariance_200": 0.01,
    }
    names = ["projection_error.png", "silhouettes.png", "ellipsoids.png"]
    assert [path.name for path in paths] == names
    for path in paths:
        with Image.open(path) as picture:
            assert np.asarray(picture.convert("L")).std() > 5
    # One number of points makes no line over their number.
    _, paths = point_sizes.draw(tmp_path / "out", workdirs[:-1])
    assert [path.name for path in paths] == names[1:]


def test_a_workdir_without_a_finished_run_is_refused_in_a_sentence(tmp_path):
    folder = make_run(tmp_path / "run", "sigma", 20, error=0.1)
    (folder / "report" / "metrics.json").unlink()
    with pytest.raises(ValueError, match="Expected a finished run.*but there is none;"):
        point_sizes.draw(tmp_path / "out", [folder])


def test_a_sphere_is_drawn_round_and_hides_what_is_behind_it():
    sigma, half_width, side = 0.1, 0.5, 200
    points = [[0.0, 0, 0], [-0.3, 0, 0]]  # the viewer is at +x
    red, blue = [1.0, 0, 0], [0.0, 0, 1]
    picture = draw_ellipsoids(
        points,
        np.array([np.eye(3), np.diag([0, 4, 1])]) * sigma**2,
        [red, blue],
        view_deg=(0, 0),
        side=side,
        half_width=half_width,
    )
    is_red = (picture[..., 0] > 0) & (picture[..., 2] == 0)
    radius = DEVIATIONS * sigma * side / (2 * half_width)
    # A pixel more or less on the rim.
    assert is_red.sum() == pytest.approx(np.pi * radius**2, rel=0.02)
    is_blue = (picture[..., 2] > 0) & (picture[..., 0] == 0)
    assert is_blue[side // 2].sum() == pytest.approx(2 * radius, abs=3)
    assert not is_blue[side // 2, side // 2]


def test_hand_tuned_runs_go_to_the_sigma_of_the_nearest_number_of_points():
    hand = point_kinds.list_changes("", 25)
    assert hand["render.sigma_end"] == point_kinds.HAND_TUNED[20]
    learned = point_kinds.list_changes("covariance", 25)
    assert "render.sigma_end" not in learned
    assert learned["network.point_size"] == "covariance"
