"""Tries of a careless or hostile user, and how one is run.

A try is a function that tries something in an empty folder. Decorated with `tries`, it
is a row of its file's table: words that its result or refusal has, and arguments.
"""

import contextlib
import functools
import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

SECONDS = 60  # after which a try hangs


class Table(list):
    """Rows for `pytest.mark.parametrize("attempt, says", ...)`."""

    def tries(self, says: str, **options):
        """Decorate a function (folder, **options) as a try."""

        def add(attempt: Callable):
            call = functools.partial(attempt, **options)
            name = "-".join([attempt.__name__, *map(str, options)])
            self.append(pytest.param(call, says, id=name))
            return attempt

        return add


def assert_try_says(attempt: Callable[[Path], object], says: str, folder: Path):
    """Fail unless a try ends in time in a result or a sentence with these words."""
    signal.signal(signal.SIGALRM, _hang)
    signal.alarm(SECONDS)
    try:
        said = str(attempt(folder))
    except (ValueError, OSError) as error:
        said = str(error)
        assert said.endswith(".")
    finally:
        signal.alarm(0)
    assert says in said


def _hang(*_):
    pytest.fail(f"still at work after {SECONDS} s")


@contextlib.contextmanager
def losing_rights() -> Iterator[tuple[Path, Callable]]:
    """A folder that anybody enters; from the call on, the rights of nobody special."""
    is_root = os.geteuid() == 0  # who may do everything
    with tempfile.TemporaryDirectory(dir="/tmp") as shared:
        os.chmod(shared, 0o755)
        try:
            yield Path(shared), lambda: is_root and os.seteuid(65534)
        finally:
            if is_root:
                os.seteuid(0)
