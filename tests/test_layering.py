"""The house: imports go down the floors only, and importing the package is light."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import dpc_jax

ROOT = Path(dpc_jax.__file__).parent
STANDARD = set(sys.stdlib_module_names)
BELOW = {  # the rooms that one run is made of
    *(
        "files",
        "outputs",
        "config",
        "render",
        "shapes",
        "data",
        "networks",
        "evaluation",
    ),
    *("learning", "reporting", "run"),
}
# Room: (third-party imports allowed, rooms of dpc_jax allowed beside its own).
ROOMS = {
    "files": (set(), set()),
    "outputs": (set(), {"files"}),
    "config": ({"ml_collections"}, set()),
    "render": ({"jax", "chex", "numpy"}, set()),
    "shapes": ({"numpy", "trimesh"}, set()),
    "data": (
        {
            "numpy",
            "trimesh",
            "embreex",
            "PIL",
            "rich",
            "scipy",
            "skimage",
            "rembg",
            "av",
        },
        {"config", "files", "outputs", "shapes"},
    ),
    "networks": ({"jax", "flax", "chex", "numpy"}, set()),
    "evaluation": ({"numpy", "scipy", "skimage", "trimesh"}, set()),
    "learning": (
        {"jax", "optax", "orbax", "chex", "numpy", "absl", "rich"},
        {"files", "config", "render", "data", "networks", "evaluation"},
    ),
    "reporting": (
        {"numpy", "scipy", "matplotlib", "trimesh", "PIL", "plotly"},
        {"files", "evaluation"},
    ),
    "run": (
        {"jax", "flax", "numpy", "orbax", "tensorboardX"},
        {
            "files",
            "outputs",
            "config",
            "render",
            "data",
            "networks",
            "evaluation",
            "learning",
            "reporting",
        },
    ),
    "experiments": (
        {"jax", "numpy", "scipy", "matplotlib", "PIL", "rich"},
        BELOW,
    ),
    "measure": (
        {"jax", "chex", "numpy", "matplotlib", "torch", "trimesh", "hypothesis"}
        | {"optax"},
        BELOW,
    ),
}
DOORWAYS = {  # and the third-party imports allowed
    "main": {"absl", "ml_collections"},
    "predict": set(),
    "fit": set(),
    "benchmark": set(),
    "stability": set(),
    "compare": {"numpy"},
    "paper": set(),
    "commands": set(),
    "__main__": set(),
    "__init__": set(),
}


def list_imports(path):
    """Dotted names that a file imports; all imports are absolute."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def list_files(room):
    """All files of a room, those of its folders too."""
    folder = ROOT / room
    return sorted(folder.rglob("*.py")) if folder.is_dir() else [ROOT / f"{room}.py"]


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_from_its_own_floor_and_below(room):
    outside, inside = ROOMS[room]
    for path in list_files(room):
        for name in list_imports(path):
            first, *rest = name.split(".")
            where = path.relative_to(ROOT)
            if first == "dpc_jax":
                assert rest[0] in inside | {room}, f"{where} imports {name}"
            elif first not in STANDARD:
                assert first in outside, f"{where} imports {name}"


@pytest.mark.parametrize("name", DOORWAYS)
def test_a_doorway_imports_no_heavy_library_itself(name):
    for imported in list_imports(ROOT / f"{name}.py"):
        first = imported.split(".")[0]
        allowed = STANDARD | {"dpc_jax"} | DOORWAYS[name]
        assert first in allowed, f"{name}.py imports {imported}"


def test_rooms_allow_each_other_no_circle():
    below = {room: inside for room, (_, inside) in ROOMS.items()}
    while below:
        floor = {room for room, inside in below.items() if not inside & below.keys()}
        assert floor, f"a circle among {sorted(below)}"
        below = {room: inside for room, inside in below.items() if room not in floor}


def test_every_module_is_in_a_room_or_a_doorway():
    names = {
        path.stem
        for path in ROOT.iterdir()
        if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    assert names == set(ROOMS) | set(DOORWAYS)


def test_imports_are_absolute():
    for path in ROOT.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            is_relative = isinstance(node, ast.ImportFrom) and node.level
            assert not is_relative, f"{path.relative_to(ROOT)} line {node.lineno}"


def test_importing_the_package_loads_no_heavy_library():
    code = (
        "import sys, dpc_jax; "
        "heavy = 'jax numpy trimesh orbax matplotlib scipy flax optax'.split(); "
        "print([m for m in heavy if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True
    )
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


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


def test_data_tools_render_processes_and_what_reads_photographs_do_not_load_jax():
    code = (
        "import sys, dpc_jax.data.__main__, dpc_jax.data.workers; "
        "import dpc_jax.predict, dpc_jax.run.prediction; "
        "print([m for m in ('jax', 'flax', 'matplotlib') if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True
    )
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


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
names += ("dpc_jax.learning.inference.volumes", "dpc_jax.learning.pose_prior")
names += ("dpc_jax.learning.shapes.view_maps", "dpc_jax.learning.shapes.voxels")
names += tuple(f"dpc_jax.learning.inference.{n}" for n in ("refinement", "refiner"))
names += ("dpc_jax.learning.poses.sampled", "dpc_jax.learning.poses.labels")
names += ("dpc_jax.learning.poses.given",)
names += ("tensorboardX",)  # nor what no flag asks for
names += tuple(f"dpc_jax.networks.{n}" for n in ("voxels", "view_maps", "pose_judge"))
print([name for name in names if name in sys.modules])
"""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True
    )
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


def test_the_public_names_are_these():
    public = {n for n in dir(dpc_jax) if not n.startswith("_")}
    public -= {"importlib", "TYPE_CHECKING"}
    modules = set(ROOMS) | set(DOORWAYS)  # those that other tests have imported
    assert public - modules == {
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
        "estimate_memory",
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
        "use_all_cores",
        "voxelize",
    }
    for name in public:
        assert getattr(dpc_jax, name) is not None
