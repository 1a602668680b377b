"""What a careless or hostile user tries, and the sentence or result that comes of it.

A row is one try: what it is, a function that tries it in an empty folder, and words of
what it returns or refuses with.
"""

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from dpc_jax.files import claiming
from dpc_jax.run.workdir import hold_workdir

SECONDS = 60  # after which a try hangs


class Try(NamedTuple):
    """One try. What it returns or refuses with has the words of `says`."""

    what: str
    attempt: Callable[[Path], Any]
    says: str


# Files: shards, records, meshes and their materials, images, locks, temporary files.


def _victim(folder: Path, link: str) -> Path:
    """A user's file, and a link to it where a file of this package should be."""
    victim = folder / "victim.txt"
    victim.write_text("mine")
    (folder / link).symlink_to(victim)
    return victim


def hold_a_workdir_whose_lock_is_a_link(folder):
    victim = _victim(folder, ".in-use")
    try:
        with hold_workdir(folder):
            pass
    finally:
        assert victim.read_text() == "mine"


def claim_a_file_whose_lock_is_a_link(folder):
    _victim(folder, ".shard.claim")
    with claiming(folder / "shard"):
        pass


FILES = [
    Try(
        "a workdir's lock that is a link to a file of the user's",
        hold_a_workdir_whose_lock_is_a_link,
        "there is a link to another file; remove the link",
    ),
    Try(
        "a shard's lock that is a link to a file of the user's",
        claim_a_file_whose_lock_is_a_link,
        "there is a link to another file; remove the link",
    ),
]

# Commands: what predict, fit, compare and main are given and told to write.

COMMANDS: list[Try] = []

# Calls of the public functions.

CALLS: list[Try] = []


def _hang(*_):
    pytest.fail(f"still at work after {SECONDS} s")


@pytest.mark.parametrize(
    "attempt, says",
    [pytest.param(*row[1:], id=row.what) for row in (*FILES, *COMMANDS, *CALLS)],
)
def test_a_try_ends_in_a_result_or_in_a_sentence(attempt, says, tmp_path):
    signal.signal(signal.SIGALRM, _hang)
    signal.alarm(SECONDS)
    try:
        said = str(attempt(tmp_path))
    except (ValueError, OSError) as error:
        said = str(error)
        assert said.startswith(said[:1].upper()) and said.endswith(".")
    finally:
        signal.alarm(0)
    assert says in said
