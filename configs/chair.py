"""Chairs from silhouettes without poses: procedural, on two CPU cores.

Cost: 681 s on one core beside other work, 1.6 GB. Reached on 100 test chairs, seeds 0
to 2, November 2026: pose accuracy 0.964, 0.974, 0.964, median error 5.3, 5.0, 4.7
degrees, Chamfer 3.57, 3.53, 3.51. ":paper" is the paper's setting: a GPU and days,
never run to the end.
"""

from dpc_jax.config import make_config


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return make_config("chair", variant)
