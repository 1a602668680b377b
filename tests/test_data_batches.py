"""Batches are a pure function of sizes, seed and step."""

import numpy as np
import pytest

from dpc_jax.data import batches
from dpc_jax.data.arrays import DataSet


def choose(step, *, models=10, batch=4, seed=0):
    return batches.choose_batch(
        np.full(models, 5), seed=seed, step=step, models_per_batch=batch,
        views_per_batch=3,
    )  # fmt: skip


def test_a_step_can_be_replayed_in_any_order():
    forward = [choose(step) for step in range(30)]
    batches._epoch_order.cache_clear()
    for step in reversed(range(30)):
        models, views = choose(step)
        np.testing.assert_array_equal(models, forward[step][0])
        np.testing.assert_array_equal(views, forward[step][1])
        models[:] = views[:] = -1  # a caller may write into its batch


@pytest.mark.parametrize("models, batch", [(10, 4), (10, 10), (7, 5), (9, 1), (13, 12)])
def test_every_model_comes_once_per_epoch_and_once_per_batch(models, batch):
    steps = 3 * models
    drawn = [choose(step, models=models, batch=batch)[0] for step in range(steps)]
    for chosen in drawn:
        assert len(set(chosen.tolist())) == batch
    for epoch in np.concatenate(drawn).reshape(-1, models):
        assert sorted(epoch) == list(range(models))


def test_epochs_steps_and_seeds_differ():
    orders = [np.concatenate([choose(2 * e + i, batch=5)[0] for i in (0, 1)])
              for e in range(4)]  # fmt: skip
    assert len({tuple(order) for order in orders}) == 4
    assert (choose(0)[0] != choose(0, seed=1)[0]).any()
    assert len({choose(step)[1].tobytes() for step in range(20)}) == 20


def test_reading_picks_each_model_with_its_own_views():
    tags = np.arange(6)[:, None] * 10 + np.arange(4)
    spread = np.broadcast_to(tags[..., None, None], (6, 4, 2, 2)).astype(np.uint8)
    data = DataSet(
        images=np.repeat(spread[..., None], 3, axis=-1), masks=spread, depths=spread,
        quaternions=np.repeat(tags[..., None], 4, -1).astype(np.float32),
        surfaces=np.zeros((6, 1, 3)), names=(), skipped=(),
    )  # fmt: skip
    batch = batches.read_batch(data, [4, 1], [[3, 0], [2, 1]])
    np.testing.assert_array_equal(batch["masks"][:, :, 0, 0], [[43, 40], [12, 11]])
    np.testing.assert_array_equal(batch["images"][:, :, 1, 1, 2], [[43, 40], [12, 11]])
    np.testing.assert_array_equal(batch["quaternions"][..., 3], [[43, 40], [12, 11]])
    assert batch["images"].dtype == np.uint8 and type(batch["images"]) is np.ndarray


def test_models_with_few_views_have_all_of_them_before_one_comes_again():
    counts = np.array([1, 2, 3, 5, 9, 40])
    seen = [set() for _ in counts]
    for step in range(200):
        models, views = batches.choose_batch(
            counts, seed=1, step=step, models_per_batch=3, views_per_batch=4
        )
        assert views.shape == (3, 4)
        for model, chosen in zip(models, views, strict=True):
            times = np.bincount(chosen, minlength=counts[model])
            assert len(times) == counts[model] and np.ptp(times) <= 1
            seen[model] |= set(chosen.tolist())
    # 100 draws of 4 of 40 miss a view with a probability below 3e-5
    assert [len(views) for views in seen] == counts.tolist()
