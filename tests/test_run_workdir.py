"""A workdir belongs to one command at a time, and to nobody once that has ended."""

import os
import signal
import subprocess
import sys

import pytest
from tiny_runs import tiny_config

from dpc_jax.config import replace_fields
from dpc_jax.run import pipeline
from dpc_jax.run.workdir import claim_workdir, hold_workdir

HOLD = """
import sys
from pathlib import Path
from dpc_jax.run.workdir import hold_workdir
with hold_workdir(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the workdir."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_a_second_command_is_refused_by_the_number_of_the_first(holder, tmp_path):
    with (
        pytest.raises(ValueError, match=f"but process {holder.pid} on .* is using it"),
        hold_workdir(tmp_path),
    ):
        pass


def test_a_process_that_was_killed_holds_nothing(holder, tmp_path):
    os.kill(holder.pid, signal.SIGKILL)
    holder.wait()
    with hold_workdir(tmp_path):
        assert str(os.getpid()) in (tmp_path / ".run.claim").read_text()
    assert not list(tmp_path.iterdir())


def test_a_command_that_is_refused_leaves_the_config_of_the_other_as_it_is(tmp_path):
    config = tiny_config()
    claim_workdir(tmp_path, config)
    before = (tmp_path / "config.json").read_bytes()
    with hold_workdir(tmp_path), pytest.raises(ValueError, match="one command at a"):
        pipeline.run(
            replace_fields(config, {"train": {"learning_rate": 0.5}}),
            tmp_path,
        )
    assert (tmp_path / "config.json").read_bytes() == before
