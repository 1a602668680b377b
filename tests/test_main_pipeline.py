"""The whole command: it reports, and what stops it on the way changes nothing."""

import contextlib
import io
import json
import os
import re
import shutil
import signal
import socket
import warnings
from pathlib import Path

import jax
import numpy as np
import pytest
import trimesh
from config_files import Command, finish, load_editable
from data_trees import save_disc, write_boxes, write_photos
from orbax.checkpoint import v1 as ocp
from PIL import Image

from dpc_jax import predict, rotation_angle_deg
from dpc_jax.config import from_fields, replace_fields
from dpc_jax.data.dataset import read_cache
from dpc_jax.data.disturbances import DISTURBANCES
from dpc_jax.evaluation.metrics import get_metric
from dpc_jax.learning.inference import refiner
from dpc_jax.learning.inference.refiner import join_views
from dpc_jax.learning.training.records import MetricLog
from dpc_jax.run import pipeline
from dpc_jax.run.report import judging
from dpc_jax.run.viewing.network_shapes import NetworkShapes
from dpc_jax.run.workdir import read_config

STEPS = 60  # two signals fall within them
EVALUATED = 40
FIELDS = {
    "log.tensorboard": True,
    "run.devices": 1,
    "train.steps": STEPS,
    "log.evaluate": EVALUATED,
    "log.checkpoint": 10,
}
TIMED = ("seconds", "steps_per_second", "compile_seconds")


def signal_at(command, workdir, step, signum):
    """Send a signal when a step is reported; gives status, what it says after it.

    The run prints into a socket that holds a few lines: without a reader it cannot get
    far beyond the step, so that the signal always falls within the training.
    """
    ours, theirs = socket.socketpair()
    theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)  # the least there is
    with ours, theirs:
        process = command.start(workdir, stdout=theirs)
        theirs.close()
        seen = b""
        while f"step {step}/".encode() not in seen:
            read = ours.recv(64)
            assert read, process.communicate()[1]
            seen += read
        process.send_signal(signum)
        while read := ours.recv(4096):
            seen += read
        error = process.communicate(timeout=1200)[1]
    return process.returncode, seen.decode(), error


def run_here(command, workdir, **changes):
    """The same in this process, which need not start."""
    config = load_editable("debug")
    config.update_from_flattened_dict(command.fields | changes)
    pipeline.run(from_fields(config.to_dict()), workdir)


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    # As many devices as here, and so threads: sums are the same bit for bit.
    folder = tmp_path_factory.mktemp("command")
    return Command(folder, FIELDS, JAX_NUM_CPU_DEVICES="4")


@pytest.fixture(scope="module")
def finished(command):
    """A run that nothing stopped: its workdir and what it printed."""
    workdir = command.folder / "unbroken"
    return workdir, finish(command.start(workdir))[0]


def read_records(workdir):
    return MetricLog(workdir / "metrics.jsonl").read()


def read_checkpoint(workdir, step):
    """Every array of a checkpoint by its path, as numpy."""
    with warnings.catch_warnings():
        # Orbax warns that arrays go where they were when they were saved: right here.
        warnings.filterwarnings("ignore", "Sharding info not provided", UserWarning)
        loaded = ocp.load_checkpointables(workdir / "checkpoints" / str(step))
    leaves = jax.tree_util.tree_flatten_with_path(loaded["state"])[0]
    return {jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}


def assert_ends_alike(workdir, unbroken):
    ours, theirs = (read_checkpoint(w, STEPS) for w in (workdir, unbroken))
    assert ours.keys() == theirs.keys() and len(ours) > 20
    for name, value in theirs.items():
        np.testing.assert_array_equal(ours[name], value, err_msg=name, strict=True)

    def strip(record):
        return {n: v for n, v in record.items() if n not in TIMED}

    assert [strip(r) for r in read_records(workdir)] == [
        strip(r) for r in read_records(unbroken)
    ]


def test_the_report_has_every_number_and_picture_that_is_promised(finished):
    workdir, out = finished
    report = workdir / "report"
    # Plain lines, as there is no terminal.
    assert "\x1b" not in out and "\r" not in out
    assert out.rstrip().endswith("report/index.html")
    metrics = json.loads((report / "metrics.json").read_text())
    names = "pose_accuracy pose_median_error_deg chamfer precision coverage".split()
    for name in [*names, "train_seconds"]:
        assert np.isfinite(metrics[name]), name
    assert metrics["steps"] == STEPS
    assert [name for name in metrics if get_metric(name).label == name] == []

    assert [*workdir.glob("tensorboard/events.*")]
    clouds = sorted((report / "points").iterdir())
    assert {path.suffix for path in clouds} == {".ply", ".glb"}
    assert len(clouds) == 2 * 3  # of the worst, the median and the best view
    for path in clouds:
        vertices = np.asarray(trimesh.load_scene(path).to_geometry().vertices)
        # A GLB holds the surface about the 40 points.
        assert len(vertices) == 40 if path.suffix == ".ply" else len(vertices) > 40
        assert np.all(np.isfinite(vertices))


def test_a_finished_run_started_again_only_reports_again(
    command, finished, capsys, monkeypatch
):
    # Figures take half the time.
    monkeypatch.setattr("dpc_jax.reporting.page._draw", lambda *_, **__: "")
    workdir, _ = finished
    records = (workdir / "metrics.jsonl").read_bytes()
    before = json.loads((workdir / "report" / "metrics.json").read_text())
    (workdir / "report" / "index.html").unlink()
    run_here(command, workdir)
    assert "loss" not in capsys.readouterr().out
    assert (workdir / "metrics.jsonl").read_bytes() == records
    assert (workdir / "report" / "index.html").exists()
    after = json.loads((workdir / "report" / "metrics.json").read_text())
    # The time of the last checkpoint is not in it.
    anew = {"data_seconds", "peak_memory_gb", "train_seconds"}
    assert after.keys() == before.keys()
    assert {n for n in before if before[n] != after[n]} <= anew


def test_a_finished_run_is_judged_on_objects_that_no_split_has(command, finished):
    workdir, _ = finished
    found = judging.judge_finally(workdir)
    kept = json.loads((workdir / "final.json").read_text())
    assert kept == {n: v if v is None else pytest.approx(v) for n, v in found.items()}
    assert found["pose_accuracy_stderr"] >= 0 and found["visible_floor_chamfer"] > 0
    # Of 10,000 points of a surface instead of 100.
    assert found["surface_floor_chamfer"] < found["floor_chamfer"]
    assert found["surface_visible_chamfer"] > found["surface_visible_floor_chamfer"]
    names = {}
    for cache in (command.folder / "data").glob("car-*"):
        names.setdefault(cache.name.split("-")[1], set()).update(
            read_cache(cache).names
        )
    others = names["train"] | names["val"] | names["test"]
    assert len(names["final"]) == found["objects"] and not names["final"] & others


def test_a_finished_run_is_judged_on_photographs_of_its_test_objects(
    finished, capsys, monkeypatch
):
    workdir, _ = finished
    found = judging.judge_photographs(workdir)
    assert [*found] == ["renders", "photographs", *DISTURBANCES]
    kept = json.loads((workdir / "photographs.json").read_text())
    assert kept["photographs"]["chamfer"] == pytest.approx(
        found["photographs"]["chamfer"]
    )
    metrics = json.loads((workdir / "report" / "metrics.json").read_text())
    # Another process's threads sum in another order.
    assert found["renders"]["chamfer"] == pytest.approx(metrics["chamfer"], rel=1e-4)
    assert "silhouette_iou" not in found["photographs"]
    chamfers = {name: round(one["chamfer"], 4) for name, one in found.items()}
    assert len({*chamfers.values()}) >= len(chamfers) - 1  # each shows other images
    assert "Wrong mask: pose accuracy" in capsys.readouterr().out
    for changes, words in (
        ({"pose": {"source": "given"}}, "was given its poses"),
        ({"network": {"shape": "voxels"}}, "predicts voxels"),
    ):
        other = replace_fields(read_config(workdir), changes)
        monkeypatch.setattr(judging, "read_config", lambda _, other=other: other)
        with pytest.raises(ValueError, match=words):
            judging.judge_photographs(workdir)


def test_a_finished_run_is_judged_on_meshes_of_another_source(finished, tmp_path):
    write_boxes(tmp_path / "boxes", 2)
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    config = json.loads((run / "config.json").read_text())
    config["data"]["cache_dir"] = str(tmp_path / "data")
    (run / "config.json").write_text(json.dumps(config))
    assert judging.judge_finally(run, tmp_path / "boxes")["objects"] == 2
    config["data"]["meshes"] = str(tmp_path / "boxes")
    (run / "config.json").write_text(json.dumps(config))
    with pytest.raises(ValueError, match="--final_meshes=DIR"):
        judging.judge_finally(run)


@pytest.fixture(scope="module")
def interrupted(command):
    """A run that is killed, damaged and interrupted, and what it says.

    One run has it all, because most of its time goes into starting. It ends in this
    process, without a report.
    """
    workdir, said = command.folder / "broken", {}
    said["killed"] = signal_at(command, workdir, 22, signal.SIGKILL)
    # A kill may also cut a line short.
    with open(workdir / "metrics.jsonl", "a", encoding="utf-8") as file:
        file.write('{"step": 1')
    said["left"] = newest, before = list_checkpoints(workdir)
    # Of one file alone half may be what later writes of the same checkpoint replaced.
    for path in (workdir / "checkpoints" / str(newest) / "state").rglob("d/*"):
        os.truncate(path, path.stat().st_size // 2)
    # Not a multiple of any interval, so that what is saved is due to the signal.
    said["interrupted"] = signal_at(command, workdir, before + 3, signal.SIGINT)
    said["saved"] = list_checkpoints(workdir)[0]
    said["last record"] = read_records(workdir)[-1]["step"]
    said["report"] = (workdir / "report").exists()
    out = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out):
        patch.setattr(pipeline, "report_run", lambda *_: None)
        run_here(command, workdir)
    return workdir, said | {"finished": out.getvalue()}


def list_checkpoints(workdir):
    """Their steps, the newest first; what a kill left of an unfinished one is none."""
    names = (path.name for path in (workdir / "checkpoints").iterdir())
    return sorted((int(name) for name in names if name.isdigit()), reverse=True)


def test_a_killed_run_goes_on_from_the_last_whole_checkpoint_and_says_so(interrupted):
    workdir, said = interrupted
    assert said["killed"][0] == -signal.SIGKILL
    newest, before = said["left"]
    assert 0 < before < newest < STEPS
    _, out, _ = said["interrupted"]
    assert f"The checkpoint of step {newest} is damaged; the one before is used." in out
    assert f"Going on from the checkpoint of step {before}." in out
    assert (workdir / f"damaged-checkpoint-{newest}").is_dir()


def test_ctrl_c_saves_the_step_reports_nothing_and_says_in_its_status_what_it_was(
    interrupted,
):
    _, said = interrupted
    status, _, error = said["interrupted"]
    assert status == 130 and "start again in the same workdir" in error
    assert said["saved"] == said["last record"] < STEPS and not said["report"]
    assert f"Going on from the checkpoint of step {said['saved']}." in said["finished"]


def test_whatever_stopped_a_run_it_ends_as_one_that_nothing_stopped(
    interrupted, finished
):
    workdir, _ = interrupted
    assert_ends_alike(workdir, finished[0])


def test_predicting_test_images_gives_what_the_report_scored(
    command, finished, tmp_path, capsys
):
    """And one of no use is named."""
    workdir, _ = finished
    caches = map(read_cache, (command.folder / "data").glob("car-test-*"))
    (test,) = (one for one in caches if one.visible is not None)
    page = (workdir / "report" / "index.html").read_text(encoding="utf-8")
    row = r"<td>\w+: (\S+), view (\d+)</td>.*?pose error ([\d.]+)°"
    shown = re.findall(row, page)
    assert len(shown) == 3
    places = [(test.names.index(name), int(view)) for name, view, _ in shown]
    names = [f"{test.names[model]}_view_{view}" for model, view in places]
    images = [str(tmp_path / f"{name}.png") for name in names]
    for path, place in zip(images, places, strict=True):
        image = np.dstack([test.images[place], test.masks[place]])
        Image.fromarray(image).save(path)
    out = tmp_path / "out"
    options = [f"--workdir={workdir}", f"--out={out}", "--crop=none"]
    bad = tmp_path / "bad.png"
    bad.write_text("no image")
    assert predict.main([*options, *images, str(bad)]) == 0
    said = capsys.readouterr()
    assert "3 of 4 images" in said.out and f"{bad} was left out" in said.err
    truth = np.stack([test.quaternions[place] for place in places])
    facts = [json.loads((out / f"{name}.json").read_text()) for name in names]
    assert {fact["frame"] for fact in facts} == {"object"}
    found = np.array([fact["quaternion"] for fact in facts])
    errors = rotation_angle_deg(found, truth)
    # Cutting an image out again at its own size blurs it by up to a pixel, and its edge
    # gets whiter. That moves a barely trained network a little, and of two candidates
    # that fit alike it may take the other one.
    away = np.abs(errors - [float(e) for *_, e in shown])
    assert (away < 3).sum() >= 2, away
    for name in names:
        cloud = trimesh.load(out / f"{name}.ply")
        shown = trimesh.load(workdir / "report" / "points" / f"{name}.ply")
        np.testing.assert_allclose(cloud.vertices, shown.vertices, atol=0.02)
    assert (out / "predictions.png").stat().st_size > 1000
    assert {path.stem for path in out.glob("*.glb")} == set(names)


def test_views_of_one_object_are_refined_together(
    finished, tmp_path, capsys, monkeypatch
):
    """In images twice as fine as the network's."""
    sides = set()

    def record(predictions, masks, groups):
        sides.add(masks.shape[-1])
        evidence = join_views(predictions, masks, groups)
        assert evidence.masks.shape[-1] == masks.shape[-1]
        return evidence

    monkeypatch.setattr(refiner, "join_views", record)
    workdir, folder = finished[0], tmp_path / "thing"
    folder.mkdir()
    for name in ("a", "b"):
        save_disc(folder / f"{name}.png")
    out = tmp_path / "out"
    options = [f"--workdir={workdir}", f"--out={out}", "--refine"]
    assert predict.main([*options, str(folder)]) == 0
    facts = json.loads((out / "thing.json").read_text())
    assert [Path(view["source"]).name for view in facts["views"]] == ["a.png", "b.png"]
    for view in facts["views"]:
        error = view["silhouette_error"]
        assert error["after"] < error["before"]
        assert 0 <= view["confidence"] <= 1 and "Trust is" in view["sentence"]
    summary = json.loads((out / "predictions.json").read_text())
    assert len(summary["images"]) == 2 and summary["left_out"] == []
    assert (out / "thing.glb").is_file()
    printed = capsys.readouterr().out
    assert all(view["sentence"] in printed for view in facts["views"])
    assert sides == {2 * read_config(workdir).data.image_size}
    assert (workdir / "data").is_dir()  # of objects that the codes are compared with


def predict_points(workdir):
    """The points that a run predicts of a grey square, [N, 3]."""
    image = np.zeros((16, 16, 4), np.uint8)
    image[4:12, 5:11] = (90, 90, 90, 255)
    path = workdir / "square.png"
    Image.fromarray(image).save(path)
    assert predict.main([f"--workdir={workdir}", str(path)]) == 0
    return np.asarray(trimesh.load(workdir / "predictions" / "square.ply").vertices)


# Labels need no alignment, one regressor no ensemble: all paths report.
OTHER_PATHS = {
    "voxels": {"network.shape": "voxels"},
    "maps": {"network.shape": "maps", "pose.source": "given"},
    "other": {"pose.source": "labels", "pose.num_heads": 1},
    "images": {"log.evaluate": 2},
}


@pytest.mark.slow  # tests/package.sh trains with known poses
@pytest.mark.parametrize("name", OTHER_PATHS)
def test_other_shapes_labelled_poses_and_other_sources_run_too(command, name, capsys):
    fields = {"train.steps": 2, "train.models_per_batch": 2} | OTHER_PATHS[name]
    if name == "other":
        meshes = str(write_boxes(command.folder / "boxes", 6))
        others = str(write_boxes(command.folder / "others", 2))
        fields = fields | {"data.meshes": meshes, "data.test_meshes": others}
    if name == "images":
        photos = command.folder / "photos"
        for i in range(6):
            write_photos(photos / f"object{i}", views=2 + i, seed=i)
        fields = fields | {"data.images": str(photos)}
    workdir = command.folder / name
    run_here(command, workdir, **fields)
    out = capsys.readouterr().out
    metrics = json.loads((workdir / "report" / "metrics.json").read_text())
    if name == "images":  # with poses, and without true shapes
        assert "Chamfer distance, precision and coverage are left out" in out
        assert metrics["chamfer"] is metrics["precision"] is metrics["coverage"] is None
        assert 0 <= metrics["pose_accuracy"] <= 1 and 0 < metrics["silhouette_iou"] < 1
    else:
        assert np.isfinite(metrics["chamfer"])
    if name == "voxels":
        assert 0 < metrics["surface_threshold"] < 1
        found = predict_points(workdir)
        assert found.shape == (10_000, 3)
        for glb in (workdir / "predictions", workdir / "report" / "points"):
            (read, *_) = trimesh.load_scene(next(glb.glob("*.glb"))).geometry.values()
            # A surface of cells of an eighth, not a small ball around each point.
            assert 0 < len(read.faces) < 8 * 10_000
            assert np.max(read.edges_unique_length) > 0.02
        assert np.linalg.norm(found, axis=1).max() < 1  # of a turned unit cube
    if name == "maps":
        # All eight maps' visible points, or one of them as often.
        assert predict_points(workdir).shape == (8 * 8 * 8, 3)
        found = (workdir / "predictions" / "predictions.json").read_text()
        (entry,) = json.loads(found)["images"]
        assert entry["quaternion"] is None and "its shape alone" in entry["sentence"]
    if name == "other":
        assert 0 <= metrics["pose_accuracy"] <= 1
        assert metrics["alignment_inlier_share"] is None
        assert metrics["test_models"] == 2


def test_the_live_view_shows_what_a_run_predicts_of_validation_and_of_an_image(
    finished, tmp_path
):
    workdir = finished[0]
    before = sorted(path for path in workdir.rglob("*") if path.is_file())
    network = NetworkShapes(workdir, Path(read_config(workdir).data.cache_dir))
    assert network.find_step() == STEPS
    network.load()
    objects = network.show_validation()
    views = read_config(workdir).data.views
    assert [len(one.views) for one in objects] == [views] * len(objects)
    for view in objects[0].views:
        assert view.image.shape[2] == 3 and view.silhouette.max() <= 1
        assert view.candidates.losses.min() > 0
        # The student's probabilities, float32.
        assert view.candidates.probabilities.sum() == pytest.approx(1, abs=1e-5)
    (one,) = network.show_images([save_disc(tmp_path / "good.png")])
    assert one.name == "good.png" and np.isfinite(one.points).all()
    (tmp_path / "bad.png").write_text("no image")
    with pytest.raises(ValueError, match="Expected a readable image"):
        network.show_images([tmp_path / "bad.png"])
    assert sorted(path for path in workdir.rglob("*") if path.is_file()) == before
