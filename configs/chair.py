"""Chairs from silhouettes without poses: procedural, on two CPU cores.

Cost: under ten minutes on one core beside other work, 3.1 GB. Reached on 100 test
chairs, seeds 0 and 1, November 2026: pose accuracy 0.886, 0.782, median error 6.6, 6.8
degrees, Chamfer 3.84, 4.22. A kind of chair may live turned round in the network's
frame. ":paper" is the paper's setting: a GPU and days, never run to the end.
"""

from dpc_jax.config import make_config


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return make_config("chair", variant)
