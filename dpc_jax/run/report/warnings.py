"""Sentences for the top of a report: what a reader of its figures has to know."""

import numpy as np

from dpc_jax.config import Config
from dpc_jax.data import DataSet
from dpc_jax.evaluation import candidates as candidate_use
from dpc_jax.run.setup import collect_warnings

_FEW_STEPS = 1000  # before which heads have hardly begun to share the views


def list_warnings(
    config: Config, sets: dict[str, DataSet], shares: np.ndarray | None
) -> list[str]:
    """Sentences on what a reader of the figures has to know.

    Args:
      sets: by name. shares: [K] of views that each head wins; None without an ensemble.
    """
    warnings = collect_warnings(config, sets) + _name_left_out(sets["test"])
    if config.pose.known:
        warnings.append(
            "This run was given the poses and learned none: pose accuracy and pose "
            "errors are absent."
        )
    if shares is not None:
        warning = candidate_use.collapse_warning(shares)
        if warning and config.train.steps < _FEW_STEPS:
            warning += f" After {config.train.steps} steps that tells nothing yet."
        warnings += [warning] if warning else []
    for one, many, pairs in (
        (
            "1 model was skipped",
            "{} models were skipped",
            [s for data in sets.values() for s in data.skipped],
        ),
        (
            "1 remark on the data",
            "{} remarks on the data",
            [r for data in sets.values() for r in data.remarks],
        ),
    ):
        if pairs:
            text = one if len(pairs) == 1 else many.format(len(pairs))
            named = "; ".join(f"{name}: {reason}" for name, reason in pairs[:10])
            warnings.append(f"{text} ({named}).")
    return warnings


def _name_left_out(dataset) -> list[str]:
    """A sentence on the metrics that a test set has no truth for."""
    if dataset.quaternions is None:
        return [
            "The test images come without poses and true shapes: pose errors, Chamfer "
            "distance, precision and coverage are left out."
        ]
    if dataset.surfaces is None:
        return [
            "The test images come without true shapes: Chamfer distance, precision and "
            "coverage are left out."
        ]
    return []
