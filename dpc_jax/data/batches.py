"""Batches as a pure function of (sizes, seed, step): any step can be replayed."""

import functools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dpc_jax.data.arrays import CORNERS, DataSet

BATCH_ARRAYS = ("images", "masks", "quaternions")  # of every batch
_MODELS, _VIEWS = 0, 1  # so that the two never share a random stream


def choose_batch(
    counts: np.ndarray,
    *,
    seed: int,
    step: int,
    models_per_batch: int,
    views_per_batch: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Which models [B] and which of their views [B, V] make the batch of a step.

    `counts` [M] is the number of views of each model.

    Models come from an endless sequence of seeded permutations: each once per epoch,
    none twice in a batch that straddles two. Views are drawn without replacement; if a
    model has fewer than the batch asks for, all of them come before any comes again.
    """
    num_models, most = len(counts), int(counts.max())
    epoch, place = divmod(step * models_per_batch, num_models)
    stop = place + models_per_batch
    models = _epoch_order(num_models, models_per_batch, seed, epoch)[place:stop]
    if stop > num_models:
        following = _epoch_order(num_models, models_per_batch, seed, epoch + 1)
        models = np.concatenate([models, following[: stop - num_models]])
    rng = np.random.default_rng([seed, _VIEWS, step])
    noise = rng.random((models_per_batch, most))
    there = counts[models][:, None]
    noise[np.arange(most) >= there] = 2.0  # views that a model has not come last
    places = np.arange(views_per_batch) % there
    # a copy, because the order is shared by all callers through the cache
    return models.copy(), np.take_along_axis(np.argsort(noise, axis=1), places, axis=1)


@functools.lru_cache(maxsize=4)
def _epoch_order(num_models, batch, seed, epoch):
    """Order of the models in one epoch.

    A batch that reaches into the next epoch takes the first models of its permutation
    that it does not hold yet. So an order depends on the one before, back to the last
    epoch that started with a fresh batch, at most `batch` epochs ago.
    """
    anchor = epoch
    while anchor * num_models % batch:
        anchor -= 1
    order = np.empty(0, np.int64)
    for current in range(anchor, epoch + 1):
        drawn = np.random.default_rng([seed, _MODELS, current]).permutation(num_models)
        held = current * num_models % batch  # models of the previous epoch in the batch
        if held:
            fresh = np.flatnonzero(~np.isin(drawn, order[-held:]))[: batch - held]
            drawn = np.concatenate([drawn[fresh], np.delete(drawn, fresh)])
        order = drawn
    return order


def read_batch(
    dataset: DataSet,
    models: npt.ArrayLike,
    views: npt.ArrayLike,
    *,
    extras: Sequence[str] = (),
) -> dict[str, np.ndarray]:
    """The views [B, V] of models [B] in memory, as stored, by the names of `DataSet`.

    They are images, masks, quaternions and the extras, as far as the set has them: of
    arrays with a row per view those of the batch, of `CORNERS` all.
    """
    rows, batch = np.asarray(models)[:, None], {}
    for name in (*BATCH_ARRAYS, *extras):
        if (array := getattr(dataset, name)) is not None:
            places = np.arange(array.shape[1])[None] if name in CORNERS else views
            batch[name] = np.asarray(array[rows, places])
    return batch
