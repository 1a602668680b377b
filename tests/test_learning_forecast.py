"""The time left: right within a fifth from the second minute on."""

import json

import numpy as np
import pytest

from dpc_jax.learning.schedules import Span, Stage
from dpc_jax.learning.training import forecast as forecasting
from dpc_jax.learning.training.forecast import Forecast

STAGES = [Stage(425, 32), Stage(875, 32), Stage(1325, 32), Stage(2000, 64)]
STARTS = [0, 1260, 2520, 3780, 6300]
SPANS = [Span(STARTS[i], STARTS[i + 1], stage) for i, stage in enumerate(STAGES)]
# Milliseconds of a step on an idle machine, as a default run has them.
COSTS = dict(zip(STAGES, [57, 66, 68, 120], strict=True))


def record_run(seed=0, *, load=0.15, validation=6.0):
    """Records of a run as `metrics.jsonl` has them: other load comes and goes."""
    rng = np.random.default_rng(seed)
    seconds, records = 0.0, []
    phase = rng.uniform(0, 2 * np.pi)
    for done in range(100, 6301, 100):
        steps = range(done - 100, done)
        cost = np.mean(
            [COSTS[s.stage] for step in steps for s in SPANS if s.start <= step < s.end]
        )
        drift = 1 + load * np.sin(phase + seconds / 90) + rng.normal(0, load / 3)
        rate = float(1000 / (cost * drift))
        seconds += 100 / rate
        record = {"step": done, "seconds": seconds, "steps_per_second": rate}
        if done == 100:
            record["compile_seconds"] = 12.0
        records.append(json.loads(json.dumps(record)))
        if done % 1000 == 0 or done == 6300:
            seconds += validation
    return records, seconds


def replay(records, end, *, costs, validation=6.0, after=0.0):
    """Errors of the time left from the second minute on, relative to what was left."""
    forecast = Forecast(SPANS, validate_every=1000, validations_after=after)
    errors = []
    for record in records:
        done = record["step"]
        forecast.add_rate(done, record["steps_per_second"])
        if record["seconds"] > 60 and not forecast._costs:  # the programs are there
            forecast.add_costs(costs)
        left = end + after * validation - record["seconds"]
        if done % 1000 == 0 or done == 6300:
            left -= validation
            forecast._validation = validation
        if record["seconds"] >= 60 and left > 0:
            error = forecast.compute_left(done) / left - 1
            errors.append(error)
    return np.array(errors)


@pytest.mark.parametrize("seed", range(5))
def test_from_the_second_minute_on_the_time_left_is_right_within_a_fifth(seed):
    errors = replay(*record_run(seed), costs=COSTS)
    assert np.mean(np.abs(errors) < 0.2) > 0.95
    # What stages ahead cost is what makes it so: the rate of now does not.
    without = replay(*record_run(seed), costs={})
    assert np.mean(np.abs(without) < 0.2) < 0.8


def test_what_follows_training_counts():
    records, end = record_run(load=0.0)
    errors = replay(records, end, costs=COSTS, after=3.0)
    assert np.abs(errors[-30:]).max() < 0.05


def test_on_an_even_machine_the_time_left_is_exact():
    forecast = Forecast(SPANS)
    forecast.add_costs(COSTS)
    forecast.add_rate(1000, 1000 / 57)
    expected = (260 * 57 + 1260 * (66 + 68) + 2520 * 120) / 1000
    assert forecast.compute_left(1000) == pytest.approx(expected)


def test_a_stage_that_is_not_known_yet_is_taken_to_cost_what_the_last_one_does():
    forecast = Forecast(SPANS)
    assert forecast.compute_left(0) is None
    forecast.add_rate(100, 10.0)
    assert forecast.compute_left(100) == pytest.approx(620)
    forecast.add_costs({STAGES[0]: 1.0, STAGES[1]: 2.0})
    assert forecast.compute_left(100) == pytest.approx(116 + 5040 * 0.2)


def test_a_stage_that_was_not_compared_counts_from_its_own_steps_alone():
    forecast = Forecast(SPANS)
    forecast.add_rate(1260, 10.0)
    forecast.add_rate(1360, 5.0)
    assert forecast.compute_left(1360) == pytest.approx(4940 / 5)


def test_waits_for_programs_still_to_come_count_where_nothing_compiles_ahead():
    forecast = Forecast(SPANS, waits=True)
    forecast.add_rate(100, 10.0)
    forecast.add_wait(15.0)
    forecast.add_wait(0.0)
    assert forecast.compute_left(100) == pytest.approx(620 + 3 * 15)
    assert Forecast(SPANS, waits=True).compute_left(0) is None


def test_the_shortest_validation_is_what_the_next_ones_take(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(forecasting.time, "monotonic", lambda: now[0])
    forecast = Forecast(SPANS, validate_every=1000)
    forecast.add_rate(1000, 10.0)
    for seconds in (30.0, 5.0, 7.0):
        with forecast.timing_validation():
            now[0] += seconds
    # At 2000, 3000, 4000, 5000, 6000 and at the end.
    assert forecast.compute_left(1000) == pytest.approx(530 + 6 * 5)
    assert forecast.compute_left(6300) == 0
    never = Forecast(SPANS, validate_every=0)
    never.add_rate(1000, 10.0)
    with never.timing_validation():
        now[0] += 4.0
    assert never.compute_left(1000) == pytest.approx(530 + 4)  # the last step has one
