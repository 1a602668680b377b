"""The metric log: whole lines only, and no step twice after a resume."""

import json

import pytest

from dpc_jax.learning.training.records import MetricLog


@pytest.fixture
def path(tmp_path):
    return tmp_path / "metrics.jsonl"


@pytest.fixture
def log(path):
    return MetricLog(path)


def record(step):
    return {"step": step, "seconds": step / 2, "loss": 1 / (1 + step)}


def fill(log, *steps):
    for step in steps:
        log.write(record(step))


def test_records_come_back_in_their_order_one_a_line(log, path):
    fill(log, 5, 10, 10)
    assert log.read() == [record(5), record(10), record(10)]
    assert [json.loads(line) for line in path.read_text().splitlines()] == log.read()


def test_a_log_that_was_never_written_is_empty_and_cutting_it_does_nothing(log, path):
    assert log.read() == []
    log.cut_after(3)
    assert not path.exists()


def test_cutting_drops_what_lies_after_a_step_and_leaves_the_rest(log):
    fill(log, 5, 10, 15, 20)
    log.cut_after(10)
    assert log.read() == [record(5), record(10)]
    log.cut_after(0)
    assert log.read() == []


def test_a_half_written_last_line_is_passed_over_and_cut_away(log, path):
    fill(log, 5, 10)
    with open(path, "a", encoding="utf-8") as file:
        file.write('{"step": 15, "sec')
    assert log.read() == [record(5), record(10)]
    log.cut_after(10)
    fill(log, 15)
    assert log.read() == [record(5), record(10), record(15)]
    assert len(path.read_text().splitlines()) == 3


def test_cutting_leaves_no_other_file_behind(log, path):
    fill(log, 5, 10)
    log.cut_after(5)
    assert list(path.parent.iterdir()) == [path]
