"""What a run records and shows: metric log, windows of steps, progress, time left."""

import json
import re
import sys

import numpy as np
import pytest

from dpc_jax.learning.training.progress import Forecast, ProgressReport
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


def show(capsys, *, seconds_left):
    with ProgressReport("Training car", total=200) as progress:
        with progress.compiling():
            pass
        progress.advance(100)
        progress.report(100, loss=1.5, steps_per_second=12.3, seconds_left=seconds_left)
    return capsys.readouterr().out


def test_plain_lines_say_that_a_program_compiles_and_how_far_a_run_is(capsys):
    lines = show(capsys, seconds_left=81.6).splitlines()
    assert lines[0] == "Training car: compiling"
    assert re.fullmatch(r"Training car: compiling took \d+\.\d s", lines[1])
    report = "Training car: step 100/200, loss 1.50, 12.3 steps/s"
    assert lines[2] == f"{report}, 82 s left"
    assert show(capsys, seconds_left=None).splitlines()[2] == report


def test_the_bar_on_a_terminal_shows_the_same_estimate(capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    for name, value in (("COLUMNS", "200"), ("TERM", "xterm"), ("FORCE_COLOR", "1")):
        monkeypatch.setenv(name, value)
    text = show(capsys, seconds_left=81.6)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)
    assert "compiling took 0.0 s" in text
    assert re.search(r"100/200 +loss 1\.50  12\.3 steps/s  82 s left", text)
    assert not re.search(r"\d:\d\d:\d\d", text)  # rich's own estimate is not there


def test_a_slower_stage_soon_counts_more_than_the_steps_before_it():
    forecast = Forecast(6000)
    assert forecast.compute_left(0) is None
    for done in range(100, 3001, 100):
        forecast.add_rate(done, 10.0)
        assert forecast.compute_left(done) == pytest.approx((6000 - done) / 10)
    for done in range(3100, 4001, 100):
        forecast.add_rate(done, 5.0)
    # Within a tenth after three minutes of the new pace.
    assert forecast.compute_left(4000) == pytest.approx(2000 / 5, rel=0.1)


def test_validations_and_what_follows_training_count():
    forecast = Forecast(100, start=50, validate_every=30, validations_after=2.0)
    forecast.add_rate(60, 10.0)
    for seconds in (9.0, 6.0):
        forecast.add_validation(seconds)
    # Those of steps 90 and 100, as long as the shortest so far.
    assert forecast.compute_left(60) == pytest.approx(40 / 10 + (2 + 2) * 6)
    assert forecast.compute_left(100) == pytest.approx(2 * 6)
