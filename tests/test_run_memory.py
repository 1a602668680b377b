"""A training step that the device's memory cannot hold is refused before it runs."""

import jax
import jax.numpy as jnp
import pytest

from dpc_jax.run.memory import check_memory

MB = 2**20


class Device:
    """A GPU of four megabytes."""

    def memory_stats(self):
        return {"bytes_limit": 4 * MB}


def compile_copies(count):
    """A program that holds its megabyte of input and `count` more of output."""

    def copy(x):
        return [x + i for i in range(count)]

    vector = jax.ShapeDtypeStruct((MB // 4,), "float32")
    return jax.jit(copy).lower(vector).compile()


def test_a_program_that_needs_more_than_the_device_has_is_refused(monkeypatch):
    monkeypatch.setattr(jax, "local_devices", lambda: [Device()])
    check_memory(compile_copies(2))
    with pytest.raises(ValueError, match="fit into the device.s memory") as refused:
        check_memory(compile_copies(8))
    assert "renders_at_once=4" in str(refused.value)
    assert "models_per_batch lower" in str(refused.value)


def test_memory_that_a_program_takes_over_from_its_input_counts_once(monkeypatch):
    monkeypatch.setattr(jax, "local_devices", lambda: [Device()])
    vector = jax.ShapeDtypeStruct((3 * MB // 4,), "float32")
    grown = jax.jit(jnp.negative, donate_argnums=0).lower(vector).compile()
    check_memory(grown)
    with pytest.raises(ValueError):
        check_memory(jax.jit(jnp.negative).lower(vector).compile())


def test_a_device_that_does_not_tell_its_memory_refuses_nothing():
    assert not jax.local_devices()[0].memory_stats()
    check_memory(compile_copies(8))
