"""What XLA says that a training step costs."""

import pytest

from dpc_jax.config import build_config, replace_fields
from dpc_jax.measure import step_profile


def test_a_step_has_costs_of_its_program_and_a_time():
    config = replace_fields(
        build_config("debug", None),
        {"run": {"devices": 1}, "render": {"num_points": 100}},
    )
    columns = step_profile.measure_step(config, 0, rounds=1)
    assert len(columns) == 6 and all(value > 0 for value in columns.values())
    # Arguments and results are the state and a batch: some megabytes.
    assert columns["arguments (MB)"] < 100


@pytest.mark.parametrize("flags", [["--steps", "10000000"], ["--rounds", "0"]])
def test_steps_beyond_the_run_and_no_rounds_are_refused(flags, capsys):
    with pytest.raises(SystemExit):
        step_profile.main(flags)
    assert "Expected steps from 0 to" in capsys.readouterr().err
