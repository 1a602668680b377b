"""launch/install.sh chooses what a GPU needs, also where there is none."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# In place of Python: notes how it is called; an environment gets a copy of it.
PYTHON = """#!/bin/sh
echo "$@" >> "$CALLS"
if [ "$2" = venv ]; then mkdir -p "$3/bin"; cp "$0" "$3/bin/python"; fi
"""


def write_script(path, text):
    path.write_text(text)
    path.chmod(0o755)
    return path


@pytest.fixture
def install(tmp_path):
    """Runs launch/install.sh; gives the finished process and what pip was asked for."""

    def run(shown, *, extras="", **environment):
        folder = tmp_path / "bin"
        folder.mkdir(exist_ok=True)
        if shown is not None:
            write_script(folder / "nvidia-smi", f"#!/bin/sh\n{shown}\n")
        calls = tmp_path / "calls"
        environment |= {
            "PATH": f"{folder}:/usr/bin:/bin",
            "CALLS": str(calls),
            "PYTHON": str(write_script(tmp_path / "python", PYTHON)),
            "VENV": str(tmp_path / "venv"),
        }
        clean = {k: v for k, v in os.environ.items() if k != "CUDA"}
        done = subprocess.run(
            ["bash", "-euc", f'. launch/install.sh "{extras}"'],
            cwd=ROOT,
            env=clean | environment,
            capture_output=True,
            text=True,
        )
        lines = calls.read_text().splitlines() if calls.exists() else []
        asked = [line.split()[-1] for line in lines if "pip install" in line]
        return done, asked

    return run


OLD = "JAX needs driver 525 and compute capability 5.2, but"


@pytest.mark.parametrize(
    "shown, cuda, extra, says",
    [
        ("580.65.06, 9.0", None, ".[cuda13]", ""),
        ("580.65.06, 7.5", None, ".[cuda13]", ""),
        ("595.10, 12.0", None, ".[cuda13]", ""),
        ("580.65.06, 7.0", None, ".[cuda12]", ""),  # CUDA 13 dropped Volta
        ("579.99, 9.0", None, ".[cuda12]", ""),
        ("525.60.13, 5.2", None, ".[cuda12]", ""),
        # The older GPU decides.
        ("580.65.06, 9.0\n580.65.06, 6.1", None, ".[cuda12]", ""),
        # A variable decides instead of the driver.
        ("580.1, 9.0", "12", ".[cuda12]", ""),
        ("580.1, 9.0", "none", ".", ""),
        # Without a GPU that works nothing is added.
        ("No devices were found", None, ".", ""),
        ("", None, ".", ""),
        ("END\nexit 9\n: <<'END'", None, ".", ""),
        (None, None, ".", ""),
        ("470.199.02, 8.6", None, ".", OLD),
        ("535.1, 3.7", None, ".", OLD),
    ],
)
def test_driver_and_gpu_decide_the_version_of_cuda(shown, cuda, extra, says, install):
    environment = {} if cuda is None else {"CUDA": cuda}
    script = None if shown is None else f"cat <<'END'\n{shown}\nEND"
    done, asked = install(script, **environment)
    assert (done.returncode, asked) == (0, [extra])
    assert says in done.stderr and bool(done.stderr) == bool(says)


def test_other_extras_are_kept_and_an_installation_is_told_and_made_once(install):
    shown = "echo '580.1, 9.0'"
    said = ("Installing .[test,lint,cuda13] into ", "")
    for start in said:
        done, asked = install(shown, extras="[test,lint]")
        assert done.returncode == 0
        assert done.stdout.startswith(start) and bool(done.stdout) == bool(start)
    assert asked == [".[test,lint,cuda13]"]


def test_another_value_of_the_variable_is_refused(install):
    done, asked = install(None, CUDA="11")
    assert done.returncode == 1 and not asked
    assert "CUDA must be 12, 13 or none, but it is 11" in done.stderr
