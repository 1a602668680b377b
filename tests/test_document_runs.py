"""The tutorial from its first line to its last, in miniature."""

import glob
import json
import os
import subprocess
import sys

import pytest
from document_blocks import ROOT, find_module, list_blocks, split_commands

# What makes each block small enough; the words of the page, and those of the test.
SMALLER = {
    "range(60)": "range(8)",
    "image_size=128": "image_size=32",
    "(2000, 3)": "(100, 3)",
}
SMALLER_FLAGS = {
    # The debug config takes the place of the car's, at four steps.
    "dpc_jax.main": ["--config.train.steps=4", "--config.train.models_per_batch=2"],
    "dpc_jax.fit": ["--points=60", "--searches=1"],
}


def run_command(words, folder):
    """A command of the page, in the folder; its standard output."""
    module, arguments = find_module(words)
    arguments = [
        word.replace("configs/car.py", f"{ROOT}/configs/debug.py") for word in arguments
    ]
    files = [sorted(glob.glob(word, root_dir=folder)) or [word] for word in arguments]
    arguments = [name for names in files for name in names]
    done = subprocess.run(
        [sys.executable, "-m", module, *arguments, *SMALLER_FLAGS.get(module, [])],
        cwd=folder,
        capture_output=True,
        text=True,
        env=os.environ
        | {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
        # A fit takes hundreds of steps, anything else hardly any.
        | {"JAX_DISABLE_MOST_OPTIMIZATIONS": str(int(module != "dpc_jax.fit"))},
    )
    assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.mark.slow
def test_the_tutorial_leads_from_images_to_a_report_and_to_clouds(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    said = {}
    for block in list_blocks("python", "sh"):
        if block.page.name != "tutorial.md":
            continue
        text = block.text
        for words, smaller in SMALLER.items():
            text = text.replace(words, smaller)
        if block.language == "python":
            exec(compile(text, block.name, "exec"), names)
            continue
        for words in split_commands(text):
            if words[0] == ".":  # the environment is that of the test
                continue
            said[" ".join(words[:4])] = run_command(words, tmp_path)
    assert "no fault found; no poses" in said["launch/data.sh check photos"]
    assert (tmp_path / "photos-sheet.png").stat().st_size > 1000
    workdir = tmp_path / "runs" / "my_cars"
    metrics = json.loads((workdir / "report" / "metrics.json").read_text())
    assert metrics["train_models"] == 6 and 0 < metrics["silhouette_iou"] < 1
    assert (workdir / "report" / "index.html").exists()
    for number in range(6):
        for kind in ("ply", "glb", "json"):
            assert (workdir / "predictions" / f"{number}.{kind}").exists()
    assert names["cloud"].vertices.shape == (100, 3)  # what the page loads last
    assert "(100, 3)" in capsys.readouterr().out
    assert (tmp_path / "car00-fit" / "cloud.glb").exists()
