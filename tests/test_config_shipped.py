"""Names of shipped configs on the command line, in place of paths."""

import runpy
from pathlib import Path

import pytest

from dpc_jax.config import list_shipped, resolve_flags

FOLDER = Path(__file__).parents[1] / "configs"


def test_the_shipped_configs_are_those_of_the_folder():
    assert list_shipped() == {path.stem: path for path in FOLDER.glob("*.py")}
    for path in list_shipped().values():
        assert callable(runpy.run_path(str(path))["get_config"])


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (["--config=car"], [f"--config={FOLDER}/car.py"]),
        (["--config", "car:paper,64"], ["--config", f"{FOLDER}/car.py:paper,64"]),
        (["-config=chair:"], [f"-config={FOLDER}/chair.py:"]),
        # Paths, unknown names, fields and workdirs stay as they are.
        (["--config=configs/car.py:paper"], ["--config=configs/car.py:paper"]),
        (["--config=bus"], ["--config=bus"]),
        (["--config.category=car"], ["--config.category=car"]),
        (["--workdir", "car"], ["--workdir", "car"]),
        (["--config=car", "car"], [f"--config={FOLDER}/car.py", "car"]),
    ],
)
def test_only_the_name_after_config_becomes_a_path(given, expected):
    assert resolve_flags(["main", *given]) == ["main", *expected]
