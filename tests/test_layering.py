"""What is loaded when: nothing heavy before it is used, no baseline unless asked for.

The layers of imports are a contract in pyproject.toml: tests/lint.sh. A light install
without the libraries of the extra "learn" is tried by tests/package.sh.
"""

import ast
from pathlib import Path

from tiny_runs import run_python

import dpc_jax

ROOT = Path(dpc_jax.__file__).parent


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
    result = run_python("-c", code)
    assert result.stdout.strip() == "[]", result.stdout + result.stderr
