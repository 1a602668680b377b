"""What XLA says that a training step costs."""

import pytest
from config_files import load

from dpc_jax.config import build_config, replace_fields
from dpc_jax.measure import step_profile


def test_steps_are_measured_of_the_config_for_cars():
    assert build_config("car", None, step_profile.CAR) == load("car")


@pytest.mark.usefixtures("quickly")
def test_a_step_of_more_points_computes_more_and_takes_more_memory():
    config = build_config("debug", None)
    config = replace_fields(config, {"run": {"devices": 1}})
    few, many = (
        step_profile.measure_step(
            replace_fields(config, {"render": {"num_points": count}}), 0, rounds=1
        )
        for count in (100, 400)
    )
    for name in ("Gflop", "arguments (MB)", "temporary (MB)"):
        assert 0 < few[name] < many[name]


@pytest.mark.parametrize("flags", [["--steps", "10000000"], ["--rounds", "0"]])
def test_steps_beyond_the_run_and_no_rounds_are_refused(flags, capsys):
    assert step_profile.main(flags) == 1
    assert "Expected steps from 0 to" in capsys.readouterr().err
