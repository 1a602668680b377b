"""TensorBoard and Weights & Biases are told what the log is told, each step once."""

import io
import json
import struct

import numpy as np
import pytest
from PIL import Image
from tiny_runs import make_dataset, tiny_config

from dpc_jax.learning.inference.predictor import Predictions
from dpc_jax.learning.training.records import MetricLog
from dpc_jax.run.trackers.content import PICTURE, draw_validation
from dpc_jax.run.trackers.tracked_log import TrackedLog, open_log

STEPS = (5, 10, 15, 20)


@pytest.fixture
def make_log(tmp_path):
    """Opens the log of a run as a start of it does."""

    def make(**changes):
        return open_log(tmp_path, tiny_config(steps=STEPS[-1], **changes))

    return make


def train_record(step):
    shares = [0.5, 0.25 + step / 100, 0.25 - step / 100]
    return {"step": step, "seconds": step / 2, "loss": 1 / step, "head_shares": shares}


def validation_record(step):
    return {"step": step, "seconds": step / 2, "pose_accuracy": 0.5, "chamfer": None}


def make_picture(step):
    return np.full((4, 6, 3), step, np.uint8)


def train(log, *steps):
    """What the training loop does; every tenth step is validated."""
    for step in steps:
        log.write(train_record(step))
        if step % 10 == 0:
            log.show(step, make_picture(step))
            log.write(validation_record(step))


def read_tensorboard(folder):
    """(step, name, value) of all events, in their order."""
    from dpc_jax.run.trackers.tensorboard_files import read_events

    for path in sorted(folder.glob("events*")):
        for event in read_events(path):
            for value in event.summary.value:
                kind = value.WhichOneof("value")
                if kind == "simple_value":
                    yield event.step, value.tag, round(value.simple_value, 6)
                elif kind == "histo":
                    yield event.step, value.tag, tuple(value.histo.bucket)
                else:
                    picture = Image.open(io.BytesIO(value.image.encoded_image_string))
                    yield event.step, value.tag, int(np.asarray(picture).max())


def read_wandb(folder):
    """(step, row) of all rows in the files that offline runs leave, oldest first."""
    from wandb.proto.wandb_internal_pb2 import Record

    for path in sorted(folder.glob("offline-run-*/*.wandb")):
        # The log format of LevelDB: blocks of 32 KiB, fragments of records in them.
        data, place, record = path.read_bytes(), 7, b""
        while place + 7 <= len(data):
            if (left := 32768 - place % 32768) < 7:
                place += left
                continue
            _, length, kind = struct.unpack_from("<IHB", data, place)
            record += data[place + 7 : place + 7 + length]
            place += 7 + length
            if kind in (1, 4):  # whole, or its last fragment
                history = Record.FromString(record).history
                record = b""
                if history.item:
                    yield (
                        history.step.num,
                        {
                            "/".join(item.nested_key) or item.key: json.loads(
                                item.value_json
                            )
                            for item in history.item
                        },
                    )


def expected_tensorboard():
    found = set()
    for step in STEPS:
        found |= {(step, "seconds", step / 2), (step, "loss", round(1 / step, 6))}
        found.add((step, "head_shares", tuple(train_record(step)["head_shares"])))
    for step in (10, 20):
        found |= {(step, "pose_accuracy", 0.5), (step, PICTURE, step)}
    return found


def test_tensorboard_has_every_number_share_and_picture(make_log, tmp_path):
    log = make_log(tensorboard=True)
    log.cut_after(0)
    train(log, *STEPS)
    log.close()
    events = list(read_tensorboard(tmp_path / "tensorboard"))
    # The seconds of step 10 and 20 come twice: in two records of the log.
    assert len(events) == len(expected_tensorboard()) + 2
    assert set(events) == expected_tensorboard()
    assert [step for step, *_ in events] == sorted(step for step, *_ in events)


def test_a_run_that_goes_on_leaves_each_step_once_in_tensorboard(make_log, tmp_path):
    log = make_log(tensorboard=True)
    log.cut_after(0)
    train(log, 5, 10, 15)
    log.close()  # a kill would leave what was flushed, and perhaps a torn event
    (path,) = (tmp_path / "tensorboard").iterdir()
    path.write_bytes(path.read_bytes()[:-3])
    log = make_log(tensorboard=True)
    log.cut_after(10)  # the step of the last checkpoint
    train(log, 15, 20)
    log.close()
    events = list(read_tensorboard(tmp_path / "tensorboard"))
    assert len(events) == len(expected_tensorboard()) + 2
    assert set(events) == expected_tensorboard()


def test_a_tool_switched_on_later_gets_what_the_log_has(make_log, tmp_path):
    train(TrackedLog(tmp_path / "metrics.jsonl", ()), 5, 10)
    log = make_log(tensorboard=True)
    log.cut_after(10)
    train(log, 15, 20)
    log.close()
    events = set(read_tensorboard(tmp_path / "tensorboard"))
    assert events == expected_tensorboard() - {(10, PICTURE, 10)}


def test_tensorboard_counts_its_time_in_seconds_of_training(make_log, tmp_path):
    from dpc_jax.run.trackers.tensorboard_files import read_events

    log = make_log(tensorboard=True)
    log.cut_after(0)
    train(log, *STEPS)
    log.close()
    (path,) = (tmp_path / "tensorboard").iterdir()
    times = {e.step: e.wall_time for e in read_events(path) if e.summary.value}
    for step in STEPS:
        assert times[step] - times[5] == pytest.approx((step - 5) / 2, abs=1e-3)


@pytest.fixture
def quiet_wandb(monkeypatch):
    """Nothing is sent anywhere, whatever the machine is set to."""
    monkeypatch.setenv("WANDB_ERROR_REPORTING", "false")
    monkeypatch.delenv("WANDB_PROJECT", raising=False)
    return pytest.importorskip("wandb")


# The library's own socket and files are closed when Python collects them.
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
def test_wandb_offline_has_the_same_and_tells_no_step_twice(
    make_log, tmp_path, quiet_wandb
):
    log = make_log(wandb="offline")
    log.cut_after(0)
    train(log, 5, 10, 15)
    log.close()
    log = make_log(wandb="offline")
    log.cut_after(10)
    train(log, 15, 20)
    log.close()
    log = make_log(wandb="offline")  # finished: nothing is left to tell
    log.cut_after(20)
    log.close()

    folders = list((tmp_path / "wandb").glob("offline-run-*"))
    assert len(folders) == 2
    # One id; folders of one second have a number of their own after it.
    assert len({folder.name.split("-")[3] for folder in folders}) == 1
    rows = list(read_wandb(tmp_path / "wandb"))
    assert [step for step, _ in rows] == list(STEPS)
    for step, row in rows:
        assert row["loss"] == pytest.approx(1 / step)
        assert row["head_shares/values"] == train_record(step)["head_shares"]
        assert row["head_shares/bins"] == [-0.5, 0.5, 1.5, 2.5]
        assert row.get("pose_accuracy") == (0.5 if step % 10 == 0 else None)
        if step % 10 == 0:
            (path,) = (f / "files" / row[f"{PICTURE}/path"] for f in folders if
                       (f / "files" / row[f"{PICTURE}/path"]).exists())  # fmt: skip
            np.testing.assert_array_equal(Image.open(path), make_picture(step))


def test_a_run_without_tools_writes_the_log_alone(make_log, tmp_path):
    log = make_log()
    log.cut_after(0)
    log.write(train_record(5))
    log.close()
    assert type(log) is MetricLog
    assert [path.name for path in tmp_path.iterdir()] == ["metrics.jsonl"]


def test_a_picture_shows_input_truth_and_prediction_of_each_view():
    dataset = make_dataset(models=3, views=2)
    silhouettes = np.zeros((3, 2, 8, 8))
    silhouettes[:, :, :4] = 1.0  # the upper half
    fields = dict.fromkeys(Predictions._fields)
    predictions = Predictions(**fields | {"silhouettes": silhouettes})
    picture = draw_validation(predictions, dataset)
    assert picture.shape == (3 * 64 + 2 * 2, 3 * 64 + 2 * 2, 3)
    for column in range(3):
        left = 66 * column
        tiles = [picture[66 * row :, left:][:64, :64] for row in range(3)]
        np.testing.assert_array_equal(tiles[0][::4, ::4], dataset.images[column, 0])
        np.testing.assert_array_equal(tiles[1][::4, ::4, 0], dataset.masks[column, 0])
        assert np.all(tiles[2][:32] == 255) and np.all(tiles[2][32:] == 0)
