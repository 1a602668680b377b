"""What is loaded when: nothing heavy before it is used, no baseline unless asked for.

The layers of imports are a contract in pyproject.toml: tests/lint.sh.
"""

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import dpc_jax
from dpc_jax.commands import COMMANDS

ROOT = Path(dpc_jax.__file__).parent


def run_lightly(code):
    """Python without the libraries of the extra "learn", as a light install has it."""
    project = tomllib.loads((ROOT.parent / "pyproject.toml").read_text())["project"]
    names = [
        re.split("[>=!<]", text)[0]
        for text in project["optional-dependencies"]["learn"]
    ]
    modules = {"ml-collections": "ml_collections", "orbax-checkpoint": "orbax"}
    modules |= {"pillow": "PIL", "scikit-image": "skimage", "absl-py": ""}  # chex's
    hidden = {modules.get(name, name) for name in names}
    block = f"""
import sys
class Hidden:
    def find_spec(name, path, target=None):
        if name.partition(".")[0] in {hidden}:
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Hidden)
"""
    command = [sys.executable, "-c", block + code]
    return subprocess.run(command, capture_output=True, text=True)


def test_the_projection_its_quaternions_and_losses_do_without_what_learning_needs():
    found = run_lightly("""
import dpc_jax, jax.numpy as jnp
image = dpc_jax.project(jnp.zeros((1, 3)), jnp.eye(3), sigma=1.0).silhouette
assert dpc_jax.reprojection_loss(image, image) == 0
one = jnp.array([1.0, 0, 0, 0])
assert dpc_jax.student_loss(one, dpc_jax.quaternion.normalize(2 * one)) == 0
try:
    dpc_jax.ShapeHead
except ModuleNotFoundError as error:
    print(error)
""")
    assert "dpc_jax.ShapeHead needs flax" in found.stdout, found.stderr


def test_every_command_says_what_a_light_install_lacks(tmp_path):
    words = {
        "train": ["--config=debug"],
        "predict": ["--workdir=w", "x"],
        "fit": ["x"],
        "compare": ["x"],
        "view": ["x"],
        "data": ["show", str(tmp_path)],
    }
    found = run_lightly(f"""
import os
os.chdir({str(tmp_path)!r})
from dpc_jax.commands import COMMANDS, main
found = []
for name in COMMANDS:
    try:
        found.append(main([name, *{words}.get(name, [])]))
    except SystemExit as ended:
        found.append(ended.code)
print(found)
""")
    assert found.stdout == f"{[1] * len(COMMANDS)}\n"
    lines = found.stderr.splitlines()
    assert len(lines) == len(COMMANDS)
    for line in lines:
        assert line.startswith("Error: ") and "pip install 'dpc_jax[learn]'" in line


def test_type_checkers_know_the_names_that_are_loaded_when_used():
    tree = ast.parse((ROOT / "__init__.py").read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    known = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert known == dpc_jax._NAMES


def test_a_run_of_point_clouds_does_not_load_what_baselines_need():
    """Nor do its programs, once traced."""
    code = """
import sys
import jax
import dpc_jax.run.pipeline, dpc_jax.run.prediction.objects
from dpc_jax.config import build_config
from dpc_jax.learning import schedules, step
from dpc_jax.run.setup import make_network
config = build_config("chair", "32")
network, steps = make_network(config), config.train.steps
stage = schedules.find_stage(steps - 1, config.render, steps=steps)
views = config.train.models_per_batch, config.train.views_per_batch
side = config.data.image_size
batch = {
    "images": jax.ShapeDtypeStruct((*views, side, side, 3), "uint8"),
    "masks": jax.ShapeDtypeStruct((*views, side, side), "uint8"),
    "quaternions": jax.ShapeDtypeStruct((*views, 4), "float32"),
}
batch["view_ids"] = jax.ShapeDtypeStruct(views, "int32")
batch["seeds"] = jax.ShapeDtypeStruct(views[:1], "uint32")
state = step.describe_state(network, config)
jax.eval_shape(step.make_train_step(network, config, stage), state, batch)
names = ("skimage", "dpc_jax.evaluation.surfaces")
names += ("dpc_jax.learning.inference.volumes",)
names += ("dpc_jax.learning.shapes.view_maps", "dpc_jax.learning.shapes.voxels")
names += ("dpc_jax.learning.inference.refiner", "dpc_jax.learning.poses.sampled")
names += ("tensorboardX",)  # nor what no flag asks for
names += tuple(f"dpc_jax.networks.{n}" for n in ("voxels", "view_maps"))
print([name for name in names if name in sys.modules])
"""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True
    )
    assert result.stdout.strip() == "[]", result.stdout + result.stderr
