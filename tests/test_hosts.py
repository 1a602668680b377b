"""A run of two processes that find each other on this machine."""

import signal
import time

import pytest
from config_files import Command, finish
from tiny_runs import find_address

from dpc_jax.learning.training.records import MetricLog

pytestmark = pytest.mark.slow  # processes that start and compile

STEPS = 24
FIELDS = {
    "run.devices": 2,
    "train.steps": STEPS,
    "log.evaluate": STEPS,
    "log.checkpoint": 8,
}
LOST = "all 2 processes of the job must go on, but"


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """In one process or two, on one data cache."""
    folder = tmp_path_factory.mktemp("command")
    command = Command(
        folder,
        FIELDS,
        # A machine that stands still for a while must not end a test.
        DPC_JAX_JOIN_SECONDS="600",
        DPC_JAX_HEARTBEAT_SECONDS="600",
        # Most of the time goes into compiling programs that run for a second.
        XDG_CACHE_HOME=str(folder / "cache"),
    )
    yield command
    for process in command.started:
        process.kill()
        process.communicate()


def start_two(command, workdir, **second):
    """Two processes with a device each; the second may have other fields."""
    flags = [f"--coordinator={find_address()}", "--processes=2"]
    return [
        command.start(workdir, *flags, "--process=0"),
        command.start(workdir, *flags, "--process=1", **second),
    ]


def read_losses(workdir):
    records = MetricLog(workdir / "metrics.jsonl").read()
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
    finish(command.start(workdir))
    return read_losses(workdir)


def test_two_processes_learn_what_one_with_two_devices_learns(command, alone):
    workdir = command.folder / "two"
    first, second = start_two(command, workdir)
    out, error = finish(first)
    assert "Report: " in out and error == ""
    out, error = finish(second)
    assert "Report: " not in out and error == ""  # process 0 speaks for both
    assert_losses_agree(read_losses(workdir), alone)
    assert (workdir / "report" / "metrics.json").is_file()
    steps = sorted(int(path.name) for path in (workdir / "checkpoints").iterdir())
    assert steps == [STEPS - 8, STEPS]


def test_processes_with_other_configs_are_refused_and_nothing_is_written(command):
    workdir = command.folder / "differing"
    for process in start_two(command, workdir, **{"train.learning_rate": 0.5}):
        _, error = finish(process, status=1)
        assert "must have the same config and versions, but process 1 differs" in error
        assert "config.train.learning_rate (0.0003 there, 0.5 here)" in error
        assert error.count("\n") == 1
    assert not workdir.exists()


@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGKILL])
def test_what_ends_one_process_ends_all_and_the_run_goes_on(command, alone, signum):
    workdir = command.folder / signum.name
    first, second = processes = start_two(command, workdir)
    wait_for_step(workdir, 12, processes)
    second.send_signal(signum)
    if signum == signal.SIGKILL:
        _, error = first.communicate(timeout=600)
        assert first.returncode != 0 and LOST in error and error.count("\n") == 1
        first, second = start_two(command, workdir)
    else:
        assert "Stopped and saved at step" in finish(first)[0]
        first, second = command.start(workdir), second  # one process goes on
    out, _ = finish(first)
    finish(second)
    assert "Going on from the checkpoint of step" in out
    assert max(read_losses(workdir)) == STEPS
    assert_losses_agree(read_losses(workdir), alone)
