"""What is loaded when: nothing heavy before it is used, no baseline unless asked for.

The layers of imports are a contract in pyproject.toml: tests/lint.sh.
"""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import dpc_jax

ROOT = Path(dpc_jax.__file__).parent


@pytest.mark.parametrize(
    "modules, heavy",
    [
        ("dpc_jax", "jax numpy trimesh orbax matplotlib scipy flax optax"),
        ("dpc_jax.data", "jax trimesh embreex rich PIL"),
        ("dpc_jax.data.__main__, dpc_jax.data.workers", "jax flax matplotlib"),
        # What reads photographs.
        ("dpc_jax.predict, dpc_jax.run.prediction", "jax flax matplotlib"),
    ],
)
def test_importing_modules_loads_no_heavy_library(modules, heavy):
    code = f"import sys, {modules}; print(set({heavy.split()}) & set(sys.modules))"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True
    )
    assert result.stdout.strip() == "set()", result.stdout + result.stderr


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
batch["seeds"] = jax.ShapeDtypeStruct(views[:1], "uint32")
state = step.describe_state(network, config)
jax.eval_shape(step.make_train_step(network, config, stage), state, batch)
names = ("skimage", "dpc_jax.evaluation.surfaces")
names += ("dpc_jax.learning.inference.volumes",)
names += ("dpc_jax.learning.shapes.view_maps", "dpc_jax.learning.shapes.voxels")
names += tuple(f"dpc_jax.learning.inference.{n}" for n in ("refinement", "refiner"))
names += ("dpc_jax.learning.poses.sampled", "dpc_jax.learning.poses.labels")
names += ("tensorboardX",)  # nor what no flag asks for
names += tuple(f"dpc_jax.networks.{n}" for n in ("voxels", "view_maps"))
print([name for name in names if name in sys.modules])
"""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True
    )
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


def test_the_public_names_are_these():
    public = {n for n in dir(dpc_jax) if not n.startswith("_")}
    public -= {"importlib", "TYPE_CHECKING"}
    # Other tests have imported some modules.
    public -= {path.stem for path in ROOT.iterdir()}
    assert public == {
        "Camera",
        "Fit",
        "FitSettings",
        "ImageEncoder",
        "MemoryEstimate",
        "PoseEnsemble",
        "PoseStudent",
        "Projection",
        "ShapeHead",
        "ShapePoseNetwork",
        "VoxelGrid",
        "align",
        "chamfer_distance",
        "choose_candidate",
        "compensate_widening",
        "count_blocks",
        "estimate_memory",
        "from_opencv",
        "mass_of_peak",
        "opacity",
        "pose_summary",
        "project",
        "project_batch",
        "project_volume",
        "quaternion",
        "reprojection_loss",
        "rotation_angle_deg",
        "smooth",
        "splat",
        "student_loss",
        "termination_probabilities",
        "to_opencv",
        "use_all_cores",
        "voxelize",
    }
    for name in public:
        assert getattr(dpc_jax, name) is not None
