"""TensorBoard is told what the log is told, each step once."""

import struct

import pytest
from tensorboardX.proto.event_pb2 import Event

from dpc_jax.learning.training.records import MetricLog, TensorBoardLog

STEPS = (5, 10, 15, 20)


def make_records(*steps):
    """What the training loop writes; every tenth step is validated."""
    for step in steps:
        seconds = {"step": step, "seconds": step / 2}
        yield seconds | {"loss": 1 / step, "head_shares": [0.5, 0.5]}
        if step % 10 == 0:
            yield seconds | {"pose_accuracy": 0.5, "chamfer": None}


def go_on(folder, step, *steps):
    """A start of a run whose last checkpoint is of `step`."""
    log = TensorBoardLog(folder / "metrics.jsonl", folder / "tensorboard")
    log.cut_after(step)
    for record in make_records(*steps):
        log.write(record)
    log.close()


def read_events(path):
    """The events of a file that have values, as TensorBoard reads them."""
    kept, data, place = [], path.read_bytes(), 0
    while place < len(data):
        length, _ = struct.unpack_from("<QI", data, place)  # and a check sum
        start, place = place + 12, place + 12 + length + 4
        kept.append(Event.FromString(data[start : start + length]))
    return [event for event in kept if event.summary.value]


def test_each_step_is_shown_once_from_the_log_s_first_on_also_after_a_kill(tmp_path):
    plain = MetricLog(tmp_path / "metrics.jsonl")  # which TensorBoard joins later
    for record in make_records(5):
        plain.write(record)
    go_on(tmp_path, 5, 10, 15)
    (path,) = (tmp_path / "tensorboard").iterdir()
    path.write_bytes(path.read_bytes()[:-3])  # a kill may leave a torn event
    go_on(tmp_path, 10, 15, 20)  # the last checkpoint is older
    expected = [
        (record["step"], name, pytest.approx(value))
        for record in make_records(*STEPS)
        for name, value in record.items()
        if isinstance(value, float)
    ]
    (path,) = (tmp_path / "tensorboard").iterdir()
    events = read_events(path)
    found = [(e.step, v.tag, v.simple_value) for e in events for v in e.summary.value]
    assert found == expected
    times = {event.step: event.wall_time for event in events}
    for step in STEPS:  # seconds of training
        assert times[step] - times[5] == pytest.approx((step - 5) / 2, abs=1e-3)
