"""Settings shared by all tests."""

import os
import tempfile

import hypothesis
import jax
import pytest
from quick_programs import compiling_quickly, use_older_loops

# Broadcasting over a missing axis is a mistake waiting to happen: say the axis. In the
# environment, so that the processes which tests start have it too.
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")
# Here jax is loaded already, and reads the environment no more.
jax.config.update("jax_numpy_rank_promotion", os.environ["JAX_NUMPY_RANK_PROMOTION"])

use_older_loops()

# Runs over several devices are tested with CPU devices: tests/test_learning_devices.py.
jax.config.update("jax_num_cpu_devices", 4)

# Commands keep compiled programs in the user's cache folder, but not those of tests.
if "XDG_CACHE_HOME" not in os.environ:
    _CACHE = tempfile.TemporaryDirectory(prefix="dpc_jax-tests-")
    os.environ["XDG_CACHE_HOME"] = _CACHE.name

# A first example compiles, so a deadline would measure the compiler.
hypothesis.settings.register_profile("local", deadline=None)
hypothesis.settings.register_profile("ci", deadline=None, derandomize=True)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "local")


# These take long, and the last file to begin is waited for alone.
_LONGEST = ("test_main_pipeline.py", "test_stability.py")


def pytest_collection_modifyitems(items):
    """Begin with the longest files."""
    items.sort(key=lambda item: item.path.name not in _LONGEST)


@pytest.fixture(scope="module")
def quickly():
    """For files whose programs run once or twice: compiling takes longest there."""
    with compiling_quickly():
        yield
