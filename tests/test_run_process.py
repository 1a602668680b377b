"""Compiled programs are kept between starts; signals ask a run to save and stop."""

import os
import signal

import jax
import pytest
from tiny_runs import run_python

from dpc_jax.run.process import (
    catch_signals,
    hasten_compilation,
    keep_compiled_programs,
)

COMPILE = """
import pathlib, sys, warnings
from dpc_jax.task import Task, run_command

def work():
    import jax, jax.numpy as jnp
    warnings.simplefilter("error")
    from dpc_jax.run.process import keep_compiled_programs
    keep_compiled_programs()
    print(jax.config.values["jax_compilation_cache_dir"])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    hits = []
    jax.monitoring.register_event_listener(lambda name, **_: hits.append(name))
    jax.jit(lambda x: jnp.sin(x) @ x.T)(jnp.ones((4, 3))).block_until_ready()
    print("hit" if "/jax/compilation_cache/cache_hits" in hits else "compiled")

sys.exit(run_command(lambda: Task(work, out=pathlib.Path("."), interrupted="")))
"""


def start(home):
    """(folder, what happened) of a process that compiles one program."""
    ours = [n for n in os.environ if "COMPILATION_CACHE" in n or "TF_CPP" in n]
    cleared = dict.fromkeys(ours) | {"XDG_CACHE_HOME": str(home)}
    done = run_python("-c", COMPILE, **cleared)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    return done.stdout.split()


def test_a_second_start_compiles_nothing_again(tmp_path):
    folder = str(tmp_path / "dpc_jax" / "programs")
    assert start(tmp_path) == [folder, "compiled"]
    assert start(tmp_path) == [folder, "hit"]


@pytest.fixture
def set_jax():
    """Sets a setting of JAX for as long as the test."""
    names = "jax_compilation_cache_dir", "jax_enable_compilation_cache"
    before = {name: jax.config.values[name] for name in names}
    yield jax.config.update
    for name, value in before.items():
        jax.config.update(name, value)


def keep():
    """The folder that programs are kept in; None for nowhere."""
    keep_compiled_programs()
    return jax.config.values["jax_compilation_cache_dir"]


def test_the_user_s_own_settings_come_first(set_jax, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    set_jax("jax_compilation_cache_dir", "/mine")
    assert keep() == "/mine"
    set_jax("jax_compilation_cache_dir", None)
    set_jax("jax_enable_compilation_cache", False)
    assert keep() is None
    set_jax("jax_enable_compilation_cache", True)
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert keep() is None
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


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


def test_a_slow_pass_of_xla_is_left_out_where_there_is_an_nvidia_gpu(
    tmp_path, monkeypatch
):
    driver = tmp_path / "nvidiactl"
    monkeypatch.setenv("XLA_FLAGS", "--xla_dump_to=/tmp")
    hasten_compilation(driver)
    assert os.environ["XLA_FLAGS"] == "--xla_dump_to=/tmp"
    driver.touch()
    hasten_compilation(driver)
    hasten_compilation(driver)
    first, second = os.environ["XLA_FLAGS"].split()
    assert first == "--xla_dump_to=/tmp" and second.startswith("--xla_disable_hlo_")
