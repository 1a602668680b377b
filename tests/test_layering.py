"""The house: imports go down the floors only, and importing the package is light."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import dpc_jax

ROOT = Path(dpc_jax.__file__).parent
STANDARD = set(sys.stdlib_module_names)
# Package: (third-party imports allowed, rooms of dpc_jax allowed).
FLOORS = {
    "render": ({"jax", "chex"}, {"render"}),
    "data": ({"numpy", "trimesh", "embreex", "PIL", "rich", "scipy"}, {"data"}),
    "networks": ({"jax", "flax", "chex", "numpy"}, {"networks", "render"}),
    "evaluation": ({"numpy", "scipy"}, {"evaluation", "render"}),
    "learning": (
        {"jax", "optax", "orbax", "chex", "numpy", "absl", "rich"},
        {"learning", "render", "data", "networks", "evaluation"},
    ),
    "reporting": (
        {"numpy", "matplotlib", "trimesh", "PIL"},
        {"reporting", "learning", "render", "data", "networks", "evaluation"},
    ),
    "benchmarking": (
        {"jax", "numpy", "matplotlib", "torch", "trimesh"},
        {"benchmarking", "reporting", "learning", "render", "data"},
    ),
    "stress": (
        {"jax", "chex", "numpy", "matplotlib", "hypothesis", "optax"},
        {
            "stress",
            "benchmarking",
            "reporting",
            "learning",
            "networks",
            "evaluation",
            "render",
            "data",
            # A training run of the stress report is one of the default configuration.
            "configuration",
            "defaults",
        },
    ),
}


def list_imports(path):
    """Absolute dotted names that a file imports."""
    package = ("dpc_jax", *path.relative_to(ROOT).parts[:-1])
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = (
                ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            )
            module = ".".join(p for p in (base, node.module or "") if p)
            yield from (f"{module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("room", FLOORS)
def test_a_room_imports_from_its_own_floor_and_below(room):
    outside, inside = FLOORS[room]
    for path in (ROOT / room).glob("*.py"):
        for name in list_imports(path):
            first, *rest = name.split(".")
            if first == "dpc_jax":
                assert rest[0] in inside, f"{path.name} imports {name}"
            elif first not in STANDARD:
                assert first in outside, f"{path.name} imports {name}"


def test_every_room_is_on_a_floor():
    rooms = {
        p.name for p in ROOT.iterdir() if p.is_dir() and (p / "__init__.py").exists()
    }
    assert rooms == set(FLOORS)


def test_importing_the_package_loads_no_heavy_library():
    code = (
        "import sys, dpc_jax; "
        "heavy = ('trimesh', 'orbax', 'matplotlib', 'scipy', 'flax', 'optax'); "
        "print([m for m in heavy if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True
    )
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


def test_the_public_names_are_these():
    public = {n for n in dir(dpc_jax) if not n.startswith("_") and n != "importlib"}
    modules = {p.stem for p in ROOT.iterdir()} | set(FLOORS)
    assert public - (modules - {"quaternion"}) == {
        "Camera",
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
        "quaternion",
        "reprojection_loss",
        "rotation_angle_deg",
        "smooth",
        "splat",
        "student_loss",
        "termination_probabilities",
        "voxelize",
    }
    for name in public:
        assert getattr(dpc_jax, name) is not None
