"""Where a process stands in its job, and what it says where the job does not start."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from tiny_runs import find_address, run_python

from dpc_jax.config import Config, name_differences, replace_fields
from dpc_jax.learning.training.agreement import list_versions
from dpc_jax.run.hosts import Place, find_place
from dpc_jax.run.hosts.joining import joining

ROOT = Path(__file__).parents[1]


def test_flags_give_a_place_in_a_job_of_several():
    assert find_place("node01:7777", 4, 3) == Place("node01:7777", 4, 3)
    assert find_place("[::1]:7777", 2, 0) == Place("[::1]:7777", 2, 0)
    assert find_place("node01:7777", 1, 0) is None
    assert find_place(None, None, None) is None


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("node01:7777", None, 0), "--coordinator, --processes and --process together"),
        (("node01", 2, 0), "--coordinator must be HOST:PORT of process 0, but it is"),
        (("node01:99999", 2, 0), "but it is 'node01:99999'"),
        (("node01:7777", 2, -1), "--process must be 0 or more .* but it is -1"),
    ],
)
def test_flags_that_give_no_place_are_refused(flags, words):
    with pytest.raises(ValueError, match=words):
        find_place(*flags)


def test_what_processes_differ_in_is_named_and_what_may_differ_is_not():
    config = Config("car")
    changes = {"data": dict(cache_dir="/other"), "train": dict(steps=7)}
    told = [list_versions(config), list_versions(replace_fields(config, changes))]
    assert name_differences(*told) == ["config.train.steps (4200 there, 7 here)"]
    assert name_differences(told[0], told[0]) == []
    old = told[0] | {"the version of jax": "0.1"}
    (differing,) = name_differences(told[0], old)
    assert differing.startswith("the version of jax")


# A step whose sum goes over all devices; process 1 is asked to stop at its fifth.
JOB = """
import json, sys
import jax, jax.numpy as jnp, numpy as np
from dpc_jax.run.hosts.joining import joining
from dpc_jax.run.hosts import Place

process, address, devices = int(sys.argv[1]), sys.argv[2], int(sys.argv[3])
jax.config.update("jax_num_cpu_devices", devices)

def fail():
    raise ValueError("the disk is full")

found = {}
with joining(Place(address, 2, process)) as job:
    found["gathered"] = job.gather("ä" * process)
    found["done"] = job.do_first(lambda: "by process 0")
    try:
        job.do_first(fail)
    except ValueError as error:
        found["failed"] = str(error)
    mesh = jax.sharding.Mesh(jax.devices(), ("all",))
    spread = jax.NamedSharding(mesh, jax.P("all"))
    step = jax.jit(lambda x: x + jnp.sum(x @ x.T), out_shardings=spread)
    shape, own = (2 * devices, 2), np.ones((1, 2), np.float32)
    value = jax.make_array_from_callback(shape, spread, lambda _: own)
    stops = job.agree_to_stop(lambda: process == 1 and found["steps"] == 5)
    found["steps"] = 1
    while not stops() and found["steps"] < 50:
        value = step(value)
        found["steps"] += 1
    print(json.dumps(found), file=sys.stderr)
"""


def test_two_processes_tell_each_other_fail_together_and_stop_at_one_step():
    command = [sys.executable, "-c", JOB]
    address = find_address()
    started = [
        subprocess.Popen(
            [*command, str(process), address, "2"],
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env=os.environ | {"JAX_PLATFORMS": "cpu"},
        )
        for process in range(2)
    ]
    errors = [process.communicate(timeout=300)[1] for process in started]
    assert [process.returncode for process in started] == [0, 0], errors
    found = [json.loads(error) for error in errors]
    assert [f.pop("done") for f in found] == ["by process 0", None]
    assert found[0] == found[1]
    assert found[0]["gathered"] == ["", "ä"]
    assert found[0]["failed"] == "the disk is full"
    assert 5 <= found[0]["steps"] <= 7


def test_processes_that_do_not_come_are_waited_for_only_so_long(tmp_path):
    """Then jax ends the process, with words of its own."""
    address = find_address()
    flags = [f"--coordinator={address}", "--processes=2", "--process=1"]
    done = run_python(
        *("-m", "dpc_jax.main", f"--config={ROOT}/configs/debug.py"),
        *(*flags, f"--workdir={tmp_path / 'w'}"),
        DPC_JAX_JOIN_SECONDS="2",
    )
    assert done.returncode != 0 and "DEADLINE_EXCEEDED" in done.stderr
    said = f"Process 1 waits up to 2 s for all 2 processes of the job at {address}."
    assert done.stdout == f"{said}\n" and not (tmp_path / "w").exists()


def test_a_port_that_is_taken_is_said_so():
    with socket.socket(socket.AF_INET6) as taken:
        taken.bind(("::", 0))
        taken.listen()
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with (
            pytest.raises(OSError, match=f"Expected process 0 to open {address} to"),
            joining(Place(address, 2, 0)),
        ):
            pass
