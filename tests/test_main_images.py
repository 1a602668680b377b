"""The whole command on a user's own images: what is left out, and known poses."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from data_trees import write_photos

ROOT = Path(__file__).parents[1]


def run(folder, *options):
    command = [sys.executable, "-m", "dpc_jax.main", f"--config={options[0]}"]
    fields = {
        "data.images": folder / "set", "data.cache_dir": folder / "cache",
        "data.image_size": 16, "render.grid": 8, "render.fine_grid": 0,
        "train.steps": 6, "train.models_per_batch": 2,
        "log.evaluate": 3,
    }  # fmt: skip
    return subprocess.run(
        [*command, f"--workdir={folder / 'run'}"]
        + [f"--config.{name}={value}" for name, value in fields.items()],
        capture_output=True, text=True, cwd=folder,
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["", ":known_pose"])
def test_photographs_train_and_the_report_says_what_is_left_out(tmp_path, variant):
    for i in range(6):
        place = tmp_path / "set" / f"object{i}"
        content, _ = write_photos(place, views=2 + i, seed=i)
        (place / "transforms.json").write_text(json.dumps(content))
    done = run(tmp_path, f"{ROOT}/configs/debug.py{variant}")
    assert done.returncode == 0, done.stderr
    assert "Chamfer distance, precision and coverage are left out" in done.stdout
    metrics = json.loads((tmp_path / "run" / "report" / "metrics.json").read_text())
    assert metrics["chamfer"] is metrics["precision"] is metrics["coverage"] is None
    assert 0 <= metrics["pose_accuracy"] <= 1 and 0 < metrics["silhouette_iou"] < 1


@pytest.mark.slow
def test_without_poses_known_pose_training_is_refused(tmp_path):
    for i in range(6):
        write_photos(tmp_path / "set" / f"object{i}", views=2, seed=i)
    done = run(tmp_path, f"{ROOT}/configs/debug.py:known_pose")
    assert done.returncode == 1 and "images have none" in done.stderr
    done = run(tmp_path, f"{ROOT}/configs/debug.py")
    assert done.returncode == 1 and "another --workdir" in done.stderr
