"""Settings shared by all tests.

They are in the environment, so that the processes which tests start have them too. What
is set already wins: `XLA_FLAGS= tests/run.sh tests` compiles as users do.
"""

import os
import tempfile

import hypothesis
import pytest
from browser import find_browser, opening_browser

_FOLDER = tempfile.TemporaryDirectory(prefix="dpc_jax-tests-")
_SETTINGS = {
    # Broadcasting over a missing axis is a mistake waiting to happen: say the axis.
    "JAX_NUMPY_RANK_PROMOTION": "raise",
    # A program is compiled once for all workers and for all processes that they start.
    "JAX_COMPILATION_CACHE_DIR": f"{_FOLDER.name}/programs",
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    # Most programs run once or twice. Compiled with little effort, and with XLA's older
    # way of writing loops, they are the same up to rounding and take half the time.
    "XLA_FLAGS": "--xla_backend_optimization_level=0"
    " --xla_cpu_use_fusion_emitters=false"
    " --xla_cpu_parallel_codegen_split_count=1",
    # Pages on each program of the cache would fill the pipes that tests read late.
    "TF_CPP_MIN_LOG_LEVEL": "3",
    # Commands keep what they have downloaded or compiled in the user's cache folder.
    "XDG_CACHE_HOME": _FOLDER.name,
}

# A first example compiles, so a deadline would measure the compiler.
hypothesis.settings.register_profile("local", deadline=None)
hypothesis.settings.register_profile("ci", deadline=None, derandomize=True)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "local")


# These take long, and the last file to begin is waited for alone.
_LONGEST = ("test_main_pipeline.py", "test_stability.py")


def pytest_configure():
    """Set the environment before jax reads it; workers inherit it from the first."""
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    import jax

    # For runs over several devices: tests/test_learning_devices.py.
    jax.config.update("jax_num_cpu_devices", 4)


def pytest_collection_modifyitems(items):
    """Begin with the longest files."""
    items.sort(key=lambda item: item.path.name not in _LONGEST)


@pytest.fixture(scope="module", autouse=True)
def free_programs():
    """A worker keeps the compiled programs of one file at a time."""
    yield
    import jax

    jax.clear_caches()


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium; without one its tests are skipped, or fail if required."""
    path = find_browser()
    if path is None:
        text = "Chromium is not installed; run tests/install_browser.sh as root."
        required = os.environ.get("DPC_JAX_BROWSER") == "required"
        (pytest.fail if required else pytest.skip)(text)
    with opening_browser(path) as opened:
        yield opened
