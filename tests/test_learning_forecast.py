"""The time left is that of the last steps' pace, with all that is still due."""

import time

import pytest

from dpc_jax.learning.training.forecast import Forecast


def test_on_an_even_machine_the_time_left_is_exact():
    forecast = Forecast(1000)
    assert forecast.compute_left(0) is None
    for done in (100, 200, 300):
        forecast.add_rate(done, 4.0)
    assert forecast.compute_left(300) == pytest.approx(700 / 4)


def test_a_slower_stage_soon_counts_more_than_the_steps_before_it():
    forecast = Forecast(6000)
    for done in range(100, 4001, 100):
        forecast.add_rate(done, 10.0 if done <= 3000 else 5.0)
    # Within a tenth after three minutes of the new pace.
    assert forecast.compute_left(4000) == pytest.approx(2000 / 5, rel=0.1)


def test_validations_and_what_follows_training_count(monkeypatch):
    clock = iter([0.0, 9.0, 20.0, 26.0])  # of two validations: 9 and 6 seconds
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    forecast = Forecast(100, validate_every=30, validations_after=2.0)
    forecast.add_rate(60, 10.0)
    for _ in range(2):
        with forecast.timing_validation():
            pass
    # Those of steps 90 and 100, as long as the shortest so far.
    assert forecast.compute_left(60) == pytest.approx(40 / 10 + (2 + 2) * 6)
    assert forecast.compute_left(100) == pytest.approx(2 * 6)


def test_a_run_that_goes_on_counts_its_own_steps_alone():
    forecast = Forecast(100, start=50)
    forecast.add_rate(60, 2.0)
    assert forecast.compute_left(60) == pytest.approx(20)
