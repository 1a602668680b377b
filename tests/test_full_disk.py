"""A full disk: a sentence that says so, what was whole stays, and the run goes on."""

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dpc_jax.files import explaining_full_disk
from dpc_jax.learning.training.records import MetricLog

IN_CPP = "RESOURCE_EXHAUSTED: Failed writing: No space left on device [os_error_code]"


def caused_by_a_full_disk():
    error = RuntimeError("a thread failed")
    error.__cause__ = OSError(errno.ENOSPC, "x")
    return error


@pytest.mark.parametrize(
    ("error", "is_full"),
    [
        (OSError(errno.ENOSPC, "x"), True),
        (OSError(errno.EDQUOT, "x"), True),
        (ValueError(IN_CPP), True),
        (caused_by_a_full_disk(), True),
        (PermissionError(errno.EACCES, "x"), False),
        (ValueError("wrong"), False),
    ],
)
def test_a_full_disk_is_named_with_its_folder_and_other_errors_stay(
    tmp_path, error, is_full
):
    with (
        pytest.raises(OSError if is_full else type(error)) as caught,
        explaining_full_disk("/outer"),
        explaining_full_disk(tmp_path),
    ):
        raise error
    says = f"The disk of {tmp_path} must have room to write to, but the disk is full"
    assert str(caught.value).startswith(says) == is_full


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux has /dev/full")
def test_a_record_that_finds_no_room_says_so(tmp_path):
    (tmp_path / "metrics.jsonl").symlink_to("/dev/full")
    with pytest.raises(OSError, match=f"disk of {tmp_path} .* the disk is full"):
        MetricLog(tmp_path / "metrics.jsonl").write({"step": 1, "seconds": 0.5})


FILL = """
import sys
from pathlib import Path
from dpc_jax.learning.training.checkpoints import Checkpoints
from tiny_runs import make_small_state

folder = Path(sys.argv[1])
checkpoints = Checkpoints(folder / "checkpoints")
checkpoints.save(make_small_state(1), seconds=1.0)
filler = folder / "filler"
try:
    with open(filler, "wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))
except OSError:
    pass
try:
    checkpoints.save(make_small_state(2), seconds=2.0)
except OSError as error:
    print(error)
checkpoints.close()
filler.unlink()

checkpoints = Checkpoints(folder / "checkpoints")
restored = checkpoints.restore(make_small_state(0))
print("restored", int(restored.state.step), restored.damaged)
checkpoints.save(make_small_state(2), seconds=2.0)
checkpoints.close()
print("saved", Checkpoints(folder / "checkpoints").steps())
"""
# In a namespace of its own, where a user may mount a small disk.
ON_A_SMALL_DISK = "unshare --user --map-root-user --mount sh -c".split()


@pytest.mark.skipif(not shutil.which("unshare"), reason="Linux has unshare")
def test_on_a_disk_that_is_really_full_nothing_is_lost_and_saving_goes_on(tmp_path):
    mount = f'mount -t tmpfs -o size=4m tmpfs {tmp_path} && echo mounted && exec "$@"'
    done = subprocess.run(
        [*ON_A_SMALL_DISK, mount, "sh", sys.executable, "-c", FILL, str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parent,
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
    )
    if not done.stdout.startswith("mounted"):
        pytest.skip("namespaces are not allowed here")
    _, sentence, *rest = done.stdout.splitlines()
    assert "the disk is full; free some" in sentence
    assert rest == ["restored 1 ()", "saved [1, 2]"]
    assert done.stderr == ""  # no traceback of any thread
