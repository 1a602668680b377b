"""Checkpoints: whole, bit for bit, and the one before where the newest is damaged."""

import contextlib
import gc

import pytest
from tiny_runs import assert_same_bits, make_small_state

from dpc_jax.learning.training.checkpoints import Checkpoints

# When a read fails, orbax drops the other reads of that checkpoint half way; Python
# says so whenever it happens to collect them.
pytestmark = pytest.mark.filterwarnings(
    "ignore:Exception ignored in:pytest.PytestUnraisableExceptionWarning"
)


@pytest.fixture(autouse=True)
def collected():
    """Have it said here, where it is expected, and not in a later file's test."""
    yield
    gc.collect()


def save(folder, *steps):
    with contextlib.closing(Checkpoints(folder / "checkpoints")) as kept:
        for step in steps:
            kept.save(make_small_state(step), seconds=step / 4)


def damage(folder, step, *, how="truncated"):
    """Cut or change the largest file of a checkpoint, where the arrays are."""
    files = (folder / "checkpoints" / str(step)).rglob("*")
    path = max((p for p in files if p.is_file()), key=lambda p: p.stat().st_size)
    content = bytearray(path.read_bytes())
    if how == "truncated":
        content = content[: len(content) // 2]
    else:
        content[len(content) // 2] ^= 1
    path.write_bytes(content)


@contextlib.contextmanager
def reopen(folder):
    with contextlib.closing(Checkpoints(folder / "checkpoints")) as kept:
        yield kept, kept.restore(make_small_state(0))


def test_the_newest_comes_back_bit_for_bit_and_the_one_before_is_kept(tmp_path):
    with reopen(tmp_path) as (kept, restored):
        assert restored is None and kept.steps() == []
    save(tmp_path, 1, 2, 3)
    # A folder without the file that is written last, left by a kill, is passed over.
    (tmp_path / "checkpoints" / "6" / "state").mkdir(parents=True)
    with reopen(tmp_path) as (kept, restored):
        assert_same_bits(restored.state, make_small_state(3))
        assert restored.seconds == 3 / 4
        assert {2, 3} <= set(kept.steps()) <= {2, 3, 6}
        # Saving a step again does nothing.
        kept.save(make_small_state(3)._replace(params={}), seconds=99.0)
    with reopen(tmp_path) as (_, restored):
        assert_same_bits(restored.state, make_small_state(3))


@pytest.mark.parametrize("how", ["truncated", "one bit changed"])
def test_a_damaged_checkpoint_is_set_aside_and_the_one_before_is_used(how, tmp_path):
    save(tmp_path, 5, 6)
    damage(tmp_path, 6, how=how)
    with reopen(tmp_path) as (kept, restored):
        assert_same_bits(restored.state, make_small_state(5))
        assert restored.damaged == (6,)
        kept.set_aside(restored.damaged)
        assert kept.steps() == [5]
        assert (tmp_path / "damaged-checkpoint-6").is_dir()
    save(tmp_path, 6)
    with reopen(tmp_path) as (_, restored):
        assert_same_bits(restored.state, make_small_state(6))
        assert restored.damaged == ()


def test_where_no_checkpoint_can_be_read_a_sentence_says_so(tmp_path):
    save(tmp_path, 5, 6)
    for step in (5, 6):
        damage(tmp_path, step)
    sentence = r"checkpoints, but none of them \(steps 6, 5\).*remove"
    with pytest.raises(ValueError, match=sentence), reopen(tmp_path):
        pass
