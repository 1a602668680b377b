"""Programs that run once or twice: compiled with as little effort as XLA can make."""

import contextlib
import inspect
import os

import jax
from jax._src import compiler

# XLA's older way of writing loops for the CPU: the same results up to rounding, and a
# training step compiles in less than half the time. What users run is compiled by the
# newer one, and so are the programs of all tests that do not ask for quick ones.
_OVERRIDES = {"xla_cpu_use_fusion_emitters": False}

# The same, of a process that a test starts.
QUICK_ENVIRONMENT = {
    "JAX_DISABLE_MOST_OPTIMIZATIONS": "true",
    "XLA_FLAGS": os.environ.get("XLA_FLAGS", "")
    + " --xla_cpu_use_fusion_emitters=false",
}


@contextlib.contextmanager
def compiling_quickly():
    """Compile without most optimisations what runs only once."""
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", True)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", before)


def use_older_loops():
    """Have XLA write loops the older way wherever optimisations are off.

    Jax has no setting for that, and XLA_FLAGS would hold for all tests of a process. A
    version of jax that has this no more, or calls it otherwise, compiles as usual.
    """
    make_options = getattr(compiler, "get_compile_options", None)
    if make_options is None:
        return
    if "env_options_overrides" not in inspect.signature(make_options).parameters:
        return

    def make_quick_options(*arguments, env_options_overrides=None, **others):
        if jax.config.read("jax_disable_most_optimizations"):
            env_options_overrides = _OVERRIDES | (env_options_overrides or {})
        return make_options(
            *arguments, env_options_overrides=env_options_overrides, **others
        )

    compiler.get_compile_options = make_quick_options
