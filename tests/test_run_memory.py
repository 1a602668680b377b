"""What a training step will take of a device's memory, told before it is compiled."""

import jax
import jax.numpy as jnp
import pytest
from tiny_runs import (
    compiling_quickly,
    make_batch,
    make_network,
    make_state,
    make_step,
    tiny_config,
)

from dpc_jax.run import memory

MB = 2**20
VECTOR = jax.ShapeDtypeStruct((MB // 4,), "float32")  # one MB


def test_what_is_no_longer_needed_makes_room():
    def run(x):
        for _ in range(5):
            x = jnp.sort(x)
        return x

    # The input stays; each result takes the place of the one before.
    assert memory.estimate_peak(run, VECTOR) == 2 * MB


def test_what_is_needed_later_is_kept():
    def run(x):
        parts = [jnp.sort(x * i) for i in range(4)]
        return sum(parts[1:], parts[0])

    assert 5 * MB <= memory.estimate_peak(run, VECTOR) <= 6 * MB


def test_the_memory_of_a_donated_input_is_used_again():
    kept = memory.estimate_peak(jax.jit(jnp.sort), VECTOR)
    donated = memory.estimate_peak(jax.jit(jnp.sort, donate_argnums=0), VECTOR)
    assert (kept, donated) == (2 * MB, MB)


def test_a_loop_takes_its_body_once_and_side_by_side_takes_all():
    rows = jax.ShapeDtypeStruct((8, MB // 4), "float32")

    def render(row):
        return jnp.sum(jnp.outer(row[:16], row))

    one = memory.estimate_peak(lambda rows: jax.lax.map(render, rows), rows)
    all_at_once = memory.estimate_peak(jax.vmap(render), rows)
    assert 24 * MB <= one <= 26 * MB
    assert 8 * MB * 17 <= all_at_once <= 8 * MB * 18


def test_the_estimate_of_a_step_is_near_the_compilers_own_layout():
    config = tiny_config(renders_at_once=1)
    network = make_network(config)
    found = memory.estimate_step_memory(network, config)
    state = make_state(network, config)
    with compiling_quickly():
        step = make_step(network, config, step=config.train.steps - 1)
        layout = step.lower(state, make_batch()).compile().memory_analysis()
    right = (
        layout.argument_size_in_bytes
        + layout.output_size_in_bytes
        + layout.temp_size_in_bytes
        - layout.alias_size_in_bytes
    )
    assert right / 3 <= found <= 2 * right  # the factors of docs/gpu.md


def test_more_than_the_device_has_is_refused_with_what_to_set():
    config = tiny_config()
    assert memory.describe_memory(2 * 10**9, 8 * 10**9, config) == (
        "Memory of a step: about 2.0 GB, at most 6.0, of 8.0 GB."
    )
    with pytest.raises(ValueError, match="renders_at_once=4 to render fewer views"):
        memory.describe_memory(9 * 10**9, 8 * 10**9, config)


def test_a_device_that_does_not_tell_its_memory_is_not_asked_for_more(capsys):
    config = tiny_config()
    memory.check_step_memory(make_network(config), config)
    assert capsys.readouterr().out == ""


class Device:
    """A GPU with one byte of memory."""

    def memory_stats(self):
        return {"bytes_limit": 1}


def test_a_device_that_is_too_small_is_refused_before_anything_is_compiled(monkeypatch):
    config = tiny_config()
    network = make_network(config)
    monkeypatch.setattr(memory, "estimate_step_memory", lambda *_: 2)
    monkeypatch.setattr(jax, "local_devices", lambda: [Device()])
    with pytest.raises(ValueError, match="must fit into the device's memory"):
        memory.check_step_memory(network, config)
