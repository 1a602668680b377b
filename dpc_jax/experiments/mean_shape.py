"""The row of the mean shape: the training set's mean as a prediction for every view."""

import numpy as np

from dpc_jax.config import Config
from dpc_jax.data import load_or_render
from dpc_jax.data.dataset import is_prepared
from dpc_jax.evaluation.mean_shape import average_distance, find_mean_shape
from dpc_jax.run.setup import make_data_specs

_VALIDATED = 20  # shapes that the number of points is tuned on, as many as align


def measure(config: Config) -> dict[str, float]:
    """Chamfer distance, precision and coverage (times 100) on the test shapes.

    Args:
      config: of a run on the same data.

    Raises:
      ValueError: for data that are not prepared, or without true shapes.
      OSError: where they cannot be read.
    """
    cache, specs = config.data.cache_dir, make_data_specs(config)
    if not all(is_prepared(spec, cache) for spec in specs.values()):
        raise ValueError(
            f"Expected the data of a finished run in {cache}, but they are not there; "
            "name their folder with --data=DIR."
        )
    sets = {
        name: load_or_render(spec, cache_dir=cache, progress=False)
        for name, spec in specs.items()
    }
    lacking = [name for name, data in sets.items() if data.surfaces is None]
    if lacking:
        raise ValueError(
            f"Expected true shapes for a mean shape, but the {lacking[0]} objects have "
            "none; leave its row out."
        )
    train, val, test = (sets[name].surfaces for name in ("train", "val", "test"))
    judged = [np.asarray(val[i]) for i in range(min(_VALIDATED, len(val)))]
    best = find_mean_shape(train, judged)
    found = average_distance(best, [np.asarray(test[i]) for i in range(len(test))])
    return found.in_paper_units() | {"mean_shape_points": float(len(best))}
