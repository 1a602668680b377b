"""What a process says where jax's client would abort it."""

import subprocess
import sys

import pytest

# The client finds that the coordinator is gone while the process is about to say what
# it found itself: both happen where process 0, told to end, is the quicker one.
SCRIPT = """
import ctypes, os, sys, threading, time
from dpc_jax.run.hosts.aborts import speaking_for_jax

try:
    with speaking_for_jax(lambda text: "process 0 has ended") as speak_itself:
        if sys.argv[1] == "told":
            speak_itself()
        os.write(2, b"JAX distributed service detected fatal errors: gone\\n")
        threading.Thread(target=ctypes.CDLL(None).abort, daemon=True).start()
        time.sleep(0.5)
        raise ValueError("process 1 differs")
except ValueError as error:
    print(f"Error: {error}", file=sys.stderr, flush=True)
    os._exit(1)
"""


@pytest.mark.parametrize(
    "told, said", [("told", "process 1 differs"), ("untold", "process 0 has ended")]
)
def test_a_process_that_says_itself_why_it_ends_is_let_finish(told, said):
    command = [sys.executable, "-c", SCRIPT, told]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr == f"Error: {said}\n"
