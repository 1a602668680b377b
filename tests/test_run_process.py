"""Compiled programs are kept between starts; signals ask a run to save and stop."""

import os
import signal
import subprocess
import sys

import pytest

from dpc_jax.run.process import catch_signals

COMPILE = """
from dpc_jax.run.task import hush_jaxlib
hush_jaxlib()
import jax, jax.numpy as jnp, sys, warnings
warnings.simplefilter("error")
from dpc_jax.run.process import keep_compiled_programs
print(keep_compiled_programs())
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
hits = []
jax.monitoring.register_event_listener(lambda name, **_: hits.append(name))
jax.jit(lambda x: jnp.sin(x) @ x.T)(jnp.ones((4, 3))).block_until_ready()
print("hit" if "/jax/compilation_cache/cache_hits" in hits else "compiled")
"""


def start(home, **environment):
    """(folder, what happened) of a process that compiles one program."""
    ours = ("COMPILATION_CACHE", "TF_CPP")
    cleared = {n: v for n, v in os.environ.items() if not any(o in n for o in ours)}
    done = subprocess.run(
        [sys.executable, "-c", COMPILE],
        capture_output=True,
        text=True,
        env=cleared | {"XDG_CACHE_HOME": str(home)} | environment,
    )
    assert done.returncode == 0 and done.stderr == "", done.stderr
    return done.stdout.split()


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """The user's cache folder after a first start, and what that start said."""
    home = tmp_path_factory.mktemp("home")
    return home, start(home)


def test_a_second_start_compiles_nothing_again(first):
    home, said = first
    folder = str(home / "dpc_jax" / "programs")
    assert said == [folder, "compiled"]
    assert start(home) == [folder, "hit"]


def test_the_user_s_own_settings_come_first(tmp_path):
    other = str(tmp_path / "mine")
    assert start(tmp_path, JAX_COMPILATION_CACHE_DIR=other)[0] == other
    off = {"JAX_ENABLE_COMPILATION_CACHE": "false"}
    assert start(tmp_path, **off) == ["None", "compiled"]
    assert not (tmp_path / "dpc_jax").exists()


def test_where_nothing_can_be_kept_everything_is_compiled(tmp_path):
    (tmp_path / "file").write_text("no folder")
    assert start(tmp_path / "file") == ["None", "compiled"]


def test_sigterm_asks_to_stop_and_no_more():
    before = signal.getsignal(signal.SIGTERM)
    with catch_signals() as asked:
        assert not asked.is_set()
        signal.raise_signal(signal.SIGTERM)
        assert asked.is_set()
    assert signal.getsignal(signal.SIGTERM) is before


def test_ctrl_c_asks_to_stop_and_a_second_one_does_not_wait():
    before = signal.getsignal(signal.SIGINT)  # ignored by jobs of a shell's background
    with pytest.raises(KeyboardInterrupt), catch_signals() as asked:
        signal.raise_signal(signal.SIGINT)
        assert asked.is_set()
    with pytest.raises(KeyboardInterrupt), catch_signals():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        raise AssertionError("it went on")
    assert signal.getsignal(signal.SIGINT) is before
