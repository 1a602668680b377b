"""The command dpc_jax: the same as python -m, and quick."""

import pytest
from tiny_runs import run_python

from dpc_jax import commands

LINES, COLUMNS = 24, 80  # of a terminal as it opens


@pytest.mark.parametrize("name", ["", *commands.COMMANDS])
def test_help_fits_a_screen(name, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    text = commands.describe()
    if name:
        text = commands.load_module(name).make_parser().format_help()
    lines = text.splitlines()
    # The line of the command itself and the next prompt are on the screen, too.
    assert len(lines) <= LINES - 2
    assert max(map(len, lines)) <= COLUMNS
    if not name:
        assert all(f"  {command} " in text for command in commands.COMMANDS)


def test_flags_are_known_before_anything_heavy_is_loaded():
    code = """
import sys
from dpc_jax.commands import COMMANDS, load_module
assert "numpy" not in sys.modules and "absl" not in sys.modules
for command in COMMANDS:
    load_module(command).make_parser().format_help()
heavy = "jax scipy trimesh embreex matplotlib flax optax orbax tensorboardX PIL"
print([name for name in heavy.split() if name in sys.modules])
"""
    done = run_python("-c", code)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


# ml_collections loads a config file by a method that Python has deprecated.
@pytest.mark.filterwarnings("ignore:the load_module:DeprecationWarning:importlib")
def test_the_fields_of_a_config_reach_the_run(capsys, monkeypatch):
    monkeypatch.setattr("dpc_jax.run.process.leave", lambda status: status)
    flags = "--config=debug:known_pose", "--config.seed=-1"
    assert commands.main(["train", *flags]) == 1
    error = capsys.readouterr().err
    assert error.startswith("Error: config.seed must be 0 or more, but it is -1")


def test_what_is_no_command_is_refused(capsys):
    assert commands.main(["trian"]) == 2
    error = capsys.readouterr().err
    assert "Expected one of train, predict" in error and "trian was given" in error


def test_help_and_version_are_answered_with_status_0(capsys):
    assert commands.main([]) == 0 and commands.main(["--help"]) == 0
    assert capsys.readouterr().out == 2 * commands.describe()
    assert commands.main(["--version"]) == 0
    assert capsys.readouterr().out[0].isdigit()
    assert run_python("-m", "dpc_jax", "train", "--help").returncode == 0
