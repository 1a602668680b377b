"""Settings shared by all tests."""

import os

import hypothesis

# Broadcasting over a missing axis is a mistake waiting to happen: say the axis. In the
# environment, so that the processes which tests start have it too.
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")

# A first example compiles, so a deadline would measure the compiler.
hypothesis.settings.register_profile("local", deadline=None)
hypothesis.settings.register_profile("ci", deadline=None, derandomize=True)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "local")


def pytest_collection_modifyitems(items):
    """Begin with the longest file: the last one to begin is waited for alone."""
    items.sort(key=lambda item: item.path.name != "test_main_pipeline.py")
