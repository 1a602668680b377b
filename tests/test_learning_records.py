"""What a run records: metric log, windows of steps."""

import json

import numpy as np
import pytest

from dpc_jax.learning.training.records import (
    MetricLog,
    NonFiniteError,
    check_step,
    summarize,
)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "metrics.jsonl"


def record(step):
    return {"step": step, "seconds": step / 2, "loss": 1 / (1 + step)}


def fill(log, *steps):
    for step in steps:
        log.write(record(step))


def test_records_come_back_in_their_order_and_can_be_cut_after_a_step(path):
    log = MetricLog(path)
    assert log.read() == []
    log.cut_after(3)
    assert not path.exists()
    fill(log, 5, 10, 10, 15)
    assert [json.loads(line) for line in path.read_text().splitlines()] == log.read()
    log.cut_after(10)
    assert log.read() == [record(5), record(10), record(10)]
    assert list(path.parent.iterdir()) == [path]
    log.cut_after(0)
    assert log.read() == []


def test_a_half_written_last_line_is_passed_over_and_cut_away(path):
    log = MetricLog(path)
    fill(log, 5, 10)
    with open(path, "a", encoding="utf-8") as file:
        file.write('{"step": 15, "sec')
    assert log.read() == [record(5), record(10)]
    log.cut_after(10)
    fill(log, 15)
    assert log.read() == [record(5), record(10), record(15)]
    assert len(path.read_text().splitlines()) == 3


def test_a_record_is_the_mean_over_its_steps_of_what_they_measured():
    """Also of a loss that some of them do not have."""

    def step(loss, norm, *winners, **others):
        norms = {"shape": norm, "pose": -1.0}  # -1: not measured in this step
        metrics = {"loss": np.float32(loss), "gradient_norms": norms, **others}
        return metrics | {"winners": np.array(winners)}

    found = summarize(
        [step(3, 2.0, 0, 3, pixel_deviation=np.float32(2)), step(1, -1.0, 7, 11)],
        heads=3,
    )
    shares = [0.5, 0.25, 0.25]  # turned candidates count for their head
    expected = {"loss": 2.0, "pixel_deviation": 2.0, "gradient_norm_shape": 2.0}
    assert found == expected | {"head_shares": shares}


@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_a_gradient_that_is_not_finite_is_named_though_the_loss_is(value):
    metrics = {"loss": 1.0, "gradient_norms": {"encoder": 1.0, "pose": value}}
    with pytest.raises(NonFiniteError, match=r"gradient of the pose .* at step 12"):
        check_step(metrics, 12, first=1.0)


@pytest.mark.parametrize(("first", "loss"), [(30.0, 2900.0), (-0.1, 50.0), (0, -99)])
def test_a_loss_that_varies_is_no_divergence(first, loss):
    check_step({"loss": loss, "gradient_norms": {"pose": -1.0}}, 12, first=first)
