"""The batch of a step: which arrays it has, and how processes read it."""

from typing import Any

import numpy as np

from dpc_jax.config import Config
from dpc_jax.data import DataSet, choose_batch, read_batch
from dpc_jax.data.arrays import CORNERS
from dpc_jax.learning import devices


def make_batch(dataset: DataSet, step: int, config: Config) -> dict[str, Any]:
    """The batch of a step, of which each process has read its own objects."""
    counts = dataset.counts
    models, views = choose_batch(
        counts,
        seed=config.seed,
        step=step,
        models_per_batch=config.train.models_per_batch,
        views_per_batch=config.train.views_per_batch,
    )
    own = devices.find_own(len(models))
    corners = CORNERS if config.network.shape == "maps" else ()
    extras = *list_extras(config), *corners
    rows = read_batch(dataset, models[own], views[own], extras=extras)
    view_ids = models[:, None] * int(counts.max()) + views
    rows["view_ids"] = view_ids[own].astype(np.int32)
    rows["seeds"] = np.full(len(models), config.seed, np.uint32)[own]
    return devices.assemble(rows, config)


def list_extras(config: Config) -> tuple[str, ...]:
    """Arrays of a data set that batches of a run hold besides the usual ones."""
    data, pose = config.data, config.pose
    is_given = {
        "depths": config.train.depth_weight,
        "translations": pose.known and data.offset and not pose.translation,
        "focal_lengths": pose.known and data.focal_spread and not pose.focal_length,
    }
    return tuple(name for name, holds in is_given.items() if holds)
