"""Programs of later stages compile while the first one trains; nothing else changes."""

import functools
import os
import sys
import threading
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import run_python

from dpc_jax.learning.schedules import Span, Stage
from dpc_jax.learning.training.programs import StagePrograms

FIRST, SECOND, THIRD = (Stage(points, 8) for points in (10, 20, 30))
SPANS = (Span(0, 1000, FIRST), Span(1000, 2000, SECOND), Span(2000, 9000, THIRD))
BATCH = {"images": np.ones((4, 3), np.float32)}


class State(NamedTuple):
    step: jax.Array
    value: jax.Array


def make_state():
    return State(jnp.asarray(0, jnp.int32), jnp.arange(3.0))


def make_step(stage):
    """A jitted step that says which stage it belongs to, and takes the old memory."""

    def step(state, batch):
        value = state.value + batch["images"].sum(axis=0)
        return State(state.step + 1, value), {"points": stage.kept_points}

    return jax.jit(step, donate_argnums=0)


class Watched:
    """Makes the steps of stages, and notes in which thread, how nice, it does so."""

    def __init__(self, fails=(), waits_for=None):
        self.fails, self.waits_for = fails, waits_for
        self.threads: dict[Stage, int] = {}
        self.niceness: dict[Stage, int] = {}

    def __call__(self, stage):
        self.threads[stage] = threading.get_ident()
        thread = threading.get_native_id()
        self.niceness[stage] = os.getpriority(os.PRIO_PROCESS, thread)
        if self.waits_for and stage != FIRST:
            self.waits_for.wait()
        if stage in self.fails:
            raise ValueError(f"{stage.kept_points} points")
        return make_step(stage)


def wait_until_compiled(programs):
    done = threading.Event()
    programs.run_ahead(done.set)  # behind what waits there
    done.wait()


def test_later_stages_are_compiled_before_they_begin_in_threads_that_give_way():
    make = Watched()
    with StagePrograms(make, SPANS) as programs:
        assert programs.find(0) is None
        programs.begin(0, state := make_state(), BATCH)
        wait_until_compiled(programs)
        for step, points in ((0, 10), (1000, 20), (2500, 30)):
            program = programs.find(step) or programs.begin(step, state, BATCH)
            _, metrics = program(old := make_state(), BATCH)
            assert int(metrics["points"]) == points
            assert programs.find(step) is program
            assert old.value.is_deleted()  # its memory was taken
    assert make.threads[SECOND] == make.threads[THIRD] != make.threads[FIRST]
    if sys.platform == "linux":
        # 19 is the most there is.
        assert make.niceness[SECOND] >= min(make.niceness[FIRST] + 1, 19)
        assert make.niceness[THIRD] == make.niceness[SECOND]


def test_a_run_that_goes_on_compiles_no_stage_that_is_over():
    make = Watched()
    with StagePrograms(make, SPANS) as programs:
        programs.begin(1500, make_state(), BATCH)
        wait_until_compiled(programs)
    assert set(make.threads) == {SECOND, THIRD}


def test_an_error_in_the_background_comes_once_all_are_compiled():
    with StagePrograms(Watched(fails=[SECOND]), SPANS) as programs:
        programs.begin(0, make_state(), BATCH)
        wait_until_compiled(programs)
        with pytest.raises(ValueError, match="20 points"):
            programs.raise_failures()
        with pytest.raises(ValueError, match="20 points"):
            programs.begin(1000, make_state(), BATCH)
        assert programs.begin(2000, make_state(), BATCH) is not None


def test_a_program_that_the_check_refuses_is_never_called():
    def refuse(program):
        assert program.memory_analysis() is not None
        raise ValueError("no room")

    with StagePrograms(make_step, SPANS, check=refuse) as programs:
        with pytest.raises(ValueError, match="no room"):
            programs.begin(0, make_state(), BATCH)


def test_nobody_waits_behind_another_stage_or_longer_than_asked():
    gate = threading.Event()
    make = Watched(waits_for=gate)
    with StagePrograms(make, SPANS) as programs:
        programs.begin(0, make_state(), BATCH)
        while SECOND not in make.threads:  # it compiles, and the third waits behind it
            time.sleep(0.01)
        answers = iter([False, False, True])
        should_stop = functools.partial(next, answers)
        start = 1000, make_state(), BATCH
        assert programs.begin(*start, should_stop=should_stop) is None
        opened = threading.Timer(0.5, gate.set)
        opened.start()
        programs.begin(2000, make_state(), BATCH)
        opened.join()
    assert make.threads[THIRD] != make.threads[SECOND]


LEAVE = """
import time
import test_learning_programs as tests
from dpc_jax.learning.training.programs import StagePrograms
from dpc_jax.run.process import leave

class Slow:
    def __init__(self, stage): self.stage = stage
    def lower(self, *structs): return self
    def compile(self): return self.stage == tests.FIRST or time.sleep(3600)

programs = StagePrograms(Slow, tests.SPANS)
with programs:
    programs.begin(0, tests.make_state(), tests.BATCH)
leave(3)
"""


def test_a_command_leaves_while_its_programs_compile():
    """Here for an hour, which Python alone would wait for."""
    done = run_python("-c", LEAVE)
    assert (done.returncode, done.stderr) == (3, "")
