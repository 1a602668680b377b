"""TensorBoard is told what the log is told, each step once."""

import io

import numpy as np
import pytest
from event_files import read_events
from PIL import Image
from tiny_runs import make_dataset

from dpc_jax.learning.inference.predictor import Predictions
from dpc_jax.learning.training.records import MetricLog
from dpc_jax.run import tensorboard
from dpc_jax.run.tensorboard import PICTURE, TensorBoardLog, draw_validation

STEPS = (5, 10, 15, 20)


@pytest.fixture
def make_log(tmp_path, monkeypatch):
    """Opens the log of a run as a start of it does; its pictures show their step."""
    monkeypatch.setattr(
        tensorboard, "draw_validation", lambda step, _: np.full((4, 6, 3), step, "u1")
    )

    def make():
        return TensorBoardLog(tmp_path / "metrics.jsonl", tmp_path / "tensorboard")

    return make


def train_record(step):
    shares = [0.5, 0.25 + step / 100, 0.25 - step / 100]
    return {"step": step, "seconds": step / 2, "loss": 1 / step, "head_shares": shares}


def validation_record(step):
    return {"step": step, "seconds": step / 2, "pose_accuracy": 0.5, "chamfer": None}


def train(log, *steps):
    """What the training loop does; every tenth step is validated."""
    for step in steps:
        log.write(train_record(step))
        if step % 10 == 0:
            log.show_validation(step, step, None)
            log.write(validation_record(step))


def read_tensorboard(folder):
    """(step, name, value) of all events, in their order."""
    for event in read_events(folder):
        for value in event.summary.value:
            kind = value.WhichOneof("value")
            if kind == "simple_value":
                yield event.step, value.tag, round(value.simple_value, 6)
            elif kind == "histo":
                yield event.step, value.tag, tuple(value.histo.bucket)
            else:
                picture = Image.open(io.BytesIO(value.image.encoded_image_string))
                yield event.step, value.tag, int(np.asarray(picture).max())


def expected_tensorboard():
    found = set()
    for step in STEPS:
        found |= {(step, "seconds", step / 2), (step, "loss", round(1 / step, 6))}
        found.add((step, "head_shares", tuple(train_record(step)["head_shares"])))
    for step in (10, 20):
        found |= {(step, "pose_accuracy", 0.5), (step, PICTURE, step)}
    return found


def test_tensorboard_has_every_number_share_and_picture_by_seconds(make_log, tmp_path):
    log = make_log()
    log.cut_after(0)
    train(log, *STEPS)
    log.close()
    events = list(read_tensorboard(tmp_path / "tensorboard"))
    # The seconds of step 10 and 20 come twice: in two records of the log.
    assert len(events) == len(expected_tensorboard()) + 2
    assert set(events) == expected_tensorboard()
    assert [step for step, *_ in events] == sorted(step for step, *_ in events)
    times = {e.step: e.wall_time for e in read_events(tmp_path / "tensorboard")}
    for step in STEPS:  # of training
        assert times[step] - times[5] == pytest.approx((step - 5) / 2, abs=1e-3)


def test_a_run_that_goes_on_leaves_each_step_once_in_tensorboard(make_log, tmp_path):
    log = make_log()
    log.cut_after(0)
    train(log, 5, 10, 15)
    log.close()  # a kill would leave what was flushed, and perhaps a torn event
    (path,) = (tmp_path / "tensorboard").iterdir()
    path.write_bytes(path.read_bytes()[:-3])
    log = make_log()
    log.cut_after(10)  # the step of the last checkpoint
    train(log, 15, 20)
    log.close()
    events = list(read_tensorboard(tmp_path / "tensorboard"))
    assert len(events) == len(expected_tensorboard()) + 2
    assert set(events) == expected_tensorboard()
    times = {e.step: e.wall_time for e in read_events(tmp_path / "tensorboard")}
    assert times[20] - times[5] == pytest.approx(7.5, abs=1e-3)


def test_a_log_that_tensorboard_joins_later_is_shown_from_its_start(make_log, tmp_path):
    plain = MetricLog(tmp_path / "metrics.jsonl")
    plain.write(train_record(5))
    plain.write(train_record(10))
    plain.write(validation_record(10))
    log = make_log()
    log.cut_after(10)
    train(log, 15, 20)
    log.close()
    events = set(read_tensorboard(tmp_path / "tensorboard"))
    assert events == expected_tensorboard() - {(10, PICTURE, 10)}


def test_a_picture_shows_input_truth_and_prediction_of_each_view():
    dataset = make_dataset(models=3, views=2)
    silhouettes = np.zeros((3, 2, 8, 8))
    silhouettes[:, :, :4] = 1.0  # the upper half
    fields = dict.fromkeys(Predictions._fields)
    predictions = Predictions(**fields | {"silhouettes": silhouettes})
    picture = draw_validation(predictions, dataset)
    assert picture.shape == (3 * 66, 3 * 66, 3)
    for column in range(3):
        left = 66 * column + 1
        tiles = [picture[66 * row + 1 :, left:][:64, :64] for row in range(3)]
        np.testing.assert_array_equal(tiles[0][::4, ::4], dataset.images[column, 0])
        np.testing.assert_array_equal(tiles[1][::4, ::4, 0], dataset.masks[column, 0])
        assert np.all(tiles[2][:32] == 255) and np.all(tiles[2][32:] == 0)
