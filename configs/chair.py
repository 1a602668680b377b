"""Chairs from silhouettes without poses: procedural, on two CPU cores.

Cost: seven to eight minutes and 1.7 GB on two cores. Seed 0 at 3500 of its 4500
steps, November 2026, on 100 test chairs: pose accuracy 0.66, median error 10.4
degrees, Chamfer 6.03. ":paper" is the paper's setting: a GPU and days, never run to
the end.
"""

from dpc_jax.defaults import apply_variant, default_config


def get_config(variant: str | None = None):
    """The config, or a variant of it: "paper", "naive", "known_pose"."""
    return apply_variant(default_config("chair"), variant)
