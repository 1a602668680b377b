"""What is measured about runs and their steps, and of which it is not."""

import pytest
from config_files import load

from dpc_jax.config import build_config, to_json
from dpc_jax.measure import candidate_ranking, resolution_costs, step_profile


def test_steps_are_measured_of_the_config_for_cars():
    assert build_config("car", None, step_profile.CAR) == load("car")


@pytest.mark.parametrize(
    ("variant", "words"),
    [
        ("mvc", "8 heads and predicts voxels"),
        ("epcg", "0 heads and predicts maps"),
        ("known_pose", "0 heads and predicts points"),
    ],
)
def test_a_ranking_is_refused_without_points_or_candidates(
    tmp_path, capsys, variant, words
):
    (tmp_path / "config.json").write_text(to_json(build_config("car", variant)))
    assert candidate_ranking.main([str(tmp_path)]) == 1
    assert words in capsys.readouterr().err


def test_a_side_that_did_not_fit_is_left_out_of_table_and_figure(tmp_path):
    fit = {"seconds": 0.026, "memory_gb": 0.68, "estimated_gb": 0.08}
    costs = [
        {"model": "points", "side": 32, **fit},
        {"model": "voxels", "side": 32, **fit},
        {"model": "points", "side": 128, **fit},
        {"model": "voxels", "side": 128, "problem": "out of memory"},
    ]
    table = resolution_costs.format_costs(costs)
    assert table.count("| 26 | 0.68 | 0.08 |") == 3 and "voxels | 128" not in table
    assert resolution_costs.draw_costs(costs, tmp_path / "costs.png").is_file()


@pytest.mark.parametrize("flags", [["--sides", "33"], ["--steps", "0"]])
def test_sides_without_a_variant_and_no_steps_are_refused(flags, capsys):
    assert resolution_costs.main(flags) == 1
    assert "Expected sides of [32, 64, 128]" in capsys.readouterr().err
