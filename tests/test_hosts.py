"""A run of two processes that find each other on this machine."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from config_files import TINY

pytestmark = pytest.mark.slow  # processes that start and compile

ROOT = Path(__file__).parents[1]
STEPS = 24
FIELDS = TINY | {
    "train.steps": STEPS,
    "log.evaluate": STEPS,
    "log.checkpoint": 8,
    "render.keep_levels": 1,
}
LOST = "all 2 processes of the job must go on, but"


class Command:
    """The main command, in one process or two, on one data cache."""

    def __init__(self, folder):
        self.folder, self.started = folder, []
        # Most of the time goes into compiling programs that run for a second.
        self.environment = os.environ | {
            "JAX_PLATFORMS": "cpu",
            # A machine that stands still for a while must not end a test.
            "DPC_JAX_JOIN_SECONDS": "600",
            "DPC_JAX_HEARTBEAT_SECONDS": "600",
            "XDG_CACHE_HOME": str(folder / "cache"),
        }

    def start(self, workdir, *flags, **changes):
        fields = FIELDS | {"data.cache_dir": self.folder / "data"} | changes
        process = subprocess.Popen(
            [sys.executable, "-m", "dpc_jax.main", f"--config={ROOT}/configs/debug.py"]
            + [f"--workdir={workdir}", *flags]
            + [f"--config.{name}={value}" for name, value in fields.items()],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self.environment,
            cwd=self.folder,
        )
        self.started.append(process)
        return process

    def start_two(self, workdir, second=None, **changes):
        """Two processes with a device each; the second may have other fields."""
        with socket.socket() as found:
            found.bind(("127.0.0.1", 0))
            address = f"127.0.0.1:{found.getsockname()[1]}"
        flags = [f"--coordinator={address}", "--processes=2"]
        changes = {"run.devices": 2} | changes
        return [
            self.start(workdir, *flags, "--process=0", **changes),
            self.start(workdir, *flags, "--process=1", **changes | (second or {})),
        ]

    def end(self):
        for process in self.started:
            process.kill()
            process.communicate()


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    command = Command(tmp_path_factory.mktemp("command"))
    yield command
    command.end()


def finish(process, status=0):
    """What a process that ends with a status has printed, and said on stderr."""
    out, error = process.communicate(timeout=600)
    assert process.returncode == status, out + error
    return out, error


def read_losses(workdir):
    lines = (workdir / "metrics.jsonl").read_text().splitlines()
    records = [json.loads(line) for line in lines]
    return {r["step"]: r["loss"] for r in records if "loss" in r}


def assert_losses_agree(losses, expected):
    assert losses.keys() == expected.keys()
    for step, loss in expected.items():
        # The sums are the same in another order: twenty steps of rounding in float32.
        assert losses[step] == pytest.approx(loss, rel=1e-5), step


def wait_for_step(workdir, step, processes):
    """Return once the log of a run has a step."""
    log = workdir / "metrics.jsonl"
    while not log.exists() or log.read_text().count("\n") < step:
        for process in processes:
            assert process.poll() is None, process.communicate()
        time.sleep(0.05)


@pytest.fixture(scope="module")
def alone(command):
    """The losses of one process with two devices."""
    workdir = command.folder / "alone"
    finish(command.start(workdir, **{"run.devices": 2}))
    return read_losses(workdir)


def test_two_processes_learn_what_one_with_two_devices_learns(command, alone):
    workdir = command.folder / "two"
    first, second = command.start_two(workdir)
    out, error = finish(first)
    assert "Report: " in out and error == ""
    out, error = finish(second)
    assert "Report: " not in out and error == ""  # process 0 speaks for both
    assert_losses_agree(read_losses(workdir), alone)
    assert (workdir / "report" / "metrics.json").is_file()
    steps = sorted(int(path.name) for path in (workdir / "checkpoints").iterdir())
    assert steps == [STEPS - 8, STEPS]


def test_all_stop_where_one_is_asked_to_and_one_process_goes_on(command, alone):
    workdir = command.folder / "stopped"
    processes = command.start_two(workdir)
    wait_for_step(workdir, 3, processes)
    processes[1].send_signal(signal.SIGTERM)
    out, _ = finish(processes[0])
    finish(processes[1])
    assert "Stopped and saved at step" in out
    stopped = max(read_losses(workdir))
    assert 3 < stopped < STEPS, "it was not stopped within the training"
    assert (workdir / "checkpoints" / str(stopped)).is_dir()
    # With another number of processes.
    out, _ = finish(command.start(workdir, **{"run.devices": 2}))
    assert f"Going on from the checkpoint of step {stopped}." in out
    assert_losses_agree(read_losses(workdir), alone)


def test_processes_with_other_configs_are_refused_and_nothing_is_written(command):
    workdir = command.folder / "differing"
    for process in command.start_two(workdir, second={"train.learning_rate": 0.5}):
        _, error = finish(process, status=1)
        assert "must have the same config and versions, but process 1 differs" in error
        assert "config.train.learning_rate (0.0003 there, 0.5 here)" in error
        assert error.count("\n") == 1
    assert not workdir.exists()


@pytest.mark.parametrize("lost", [0, 1])
def test_a_killed_process_ends_all_and_the_same_command_goes_on(command, alone, lost):
    workdir = command.folder / f"killed-{lost}"
    processes = command.start_two(workdir)
    wait_for_step(workdir, 12, processes)
    processes[lost].kill()
    _, error = processes[1 - lost].communicate(timeout=600)
    assert processes[1 - lost].returncode != 0
    if lost:  # of process 0 jax itself tells, or our sentence
        assert LOST in error and error.count("\n") == 1
    assert (workdir / "checkpoints" / "8").is_dir()
    first, second = command.start_two(workdir)
    out, _ = finish(first)
    finish(second)
    assert "Going on from the checkpoint of step" in out
    assert_losses_agree(read_losses(workdir), alone)
