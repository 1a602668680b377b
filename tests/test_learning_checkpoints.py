"""Checkpoints: whole, bit for bit, and the one before where the newest is damaged."""

import gc

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import assert_same_bits

from dpc_jax.learning.step import TrainState
from dpc_jax.learning.training.checkpoints import Checkpoints


def make_small_state(step):
    """A state with every kind of leaf that a run has."""
    rng = np.random.default_rng(step)
    return TrainState(
        step=jnp.asarray(step, jnp.int32),
        params={"params": {"a": jnp.array(rng.normal(size=(30, 40)), jnp.float32)}},
        optimizer=(jnp.asarray(step, jnp.int32), {"mu": jnp.full((5,), 1e-30)}),
        covariance=jnp.eye(3) * step,
    )


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


@pytest.fixture
def opened(tmp_path):
    kept = Checkpoints(tmp_path / "checkpoints")
    yield kept
    kept.close()


def save_some(kept, *steps):
    for step in steps:
        kept.save(make_small_state(step), seconds=step / 4)
    kept.close()


def damage(folder, *, how):
    """Cut or change the largest file of a checkpoint, where the arrays are."""
    path = max(
        (p for p in folder.rglob("*") if p.is_file()), key=lambda p: p.stat().st_size
    )
    content = bytearray(path.read_bytes())
    if how == "truncated":
        content = content[: len(content) // 2]
    else:
        content[len(content) // 2] ^= 1
    path.write_bytes(content)


def reopen(tmp_path):
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    return checkpoints, checkpoints.restore(make_small_state(0))


def test_where_there_is_no_checkpoint_none_is_restored(opened):
    assert opened.restore(make_small_state(0)) is None
    assert opened.steps() == []


def test_a_state_comes_back_bit_for_bit_with_its_seconds(opened, tmp_path):
    save_some(opened, 7)
    again, restored = reopen(tmp_path)
    assert_same_bits(restored.state, make_small_state(7))
    assert restored.seconds == 7 / 4
    assert restored.damaged == ()
    again.close()


def test_the_newest_is_restored_and_the_one_before_is_kept(opened, tmp_path):
    save_some(opened, 1, 2, 3)
    again, restored = reopen(tmp_path)
    assert int(restored.state.step) == 3
    assert again.steps() == [2, 3]
    again.close()


def test_saving_a_step_again_does_nothing(opened, tmp_path):
    save_some(opened, 4)
    again, _ = reopen(tmp_path)
    other = make_small_state(4)._replace(covariance=jnp.zeros((3, 3)))
    again.save(other, seconds=99.0)
    again.close()
    again, restored = reopen(tmp_path)
    assert_same_bits(restored.state, make_small_state(4))
    again.close()


@pytest.mark.parametrize("how", ["truncated", "one bit changed"])
def test_of_a_damaged_newest_checkpoint_the_one_before_is_used_and_it_is_said(
    opened, tmp_path, how
):
    save_some(opened, 5, 6)
    damage(tmp_path / "checkpoints" / "6", how=how)
    again, restored = reopen(tmp_path)
    assert_same_bits(restored.state, make_small_state(5))
    assert restored.damaged == (6,)
    again.close()


def test_a_damaged_checkpoint_is_set_aside_so_that_its_step_can_be_saved_again(
    opened, tmp_path
):
    save_some(opened, 5, 6)
    damage(tmp_path / "checkpoints" / "6", how="truncated")
    again, restored = reopen(tmp_path)
    again.set_aside(restored.damaged)
    assert again.steps() == [5]
    assert (tmp_path / "damaged-checkpoint-6").is_dir()
    again.save(make_small_state(6), seconds=1.5)
    again.close()
    again, restored = reopen(tmp_path)
    assert_same_bits(restored.state, make_small_state(6))
    assert restored.damaged == ()
    again.close()


def test_where_no_checkpoint_can_be_read_a_sentence_says_so(opened, tmp_path):
    save_some(opened, 5, 6)
    for step in "56":
        damage(tmp_path / "checkpoints" / step, how="truncated")
    with pytest.raises(
        ValueError, match=r"checkpoints, but none of them \(steps 6, 5\).*remove"
    ):
        reopen(tmp_path)


def test_the_moving_baseline_of_drawn_poses_is_kept(opened, tmp_path):
    drawing = make_small_state(4)._replace(cost=jnp.asarray(0.3125))
    opened.save(drawing, seconds=1.0)
    opened.close()
    again = Checkpoints(tmp_path / "checkpoints")
    found = again.restore(make_small_state(0)._replace(cost=jnp.zeros(())))
    again.close()
    assert_same_bits(found.state, drawing)


def test_what_a_kill_left_of_an_unfinished_checkpoint_is_passed_over(opened, tmp_path):
    save_some(opened, 5)
    # A folder without the file that is written last is no checkpoint.
    leftover = tmp_path / "checkpoints" / "6"
    leftover.mkdir()
    (leftover / "state").mkdir()
    again, restored = reopen(tmp_path)
    assert int(restored.state.step) == 5
    again.close()


def test_memory_given_up_after_saving_does_not_change_what_is_saved(opened, tmp_path):
    # The next training step takes the state's memory while it is still being written.
    state = make_small_state(3)
    opened.save(state, seconds=0.0)
    overwrite = jax.jit(lambda s: jax.tree.map(lambda a: a * 0, s), donate_argnums=0)
    jax.block_until_ready(overwrite(state))
    opened.close()
    again, restored = reopen(tmp_path)
    assert_same_bits(restored.state, make_small_state(3))
    again.close()
