"""Chairs from silhouettes without poses: procedural, on two CPU cores.

Cost: five minutes and 1.4 to 3.0 GB. Reached on 100 test chairs, seeds 0, 1, 2,
November 2026: pose accuracy 0.726, 0.682, 0.826, median error 6.8, 7.6, 6.7 degrees,
Chamfer 4.73, 5.08, 4.44. A kind of chair may live turned round in the network's frame:
up to a quarter of the views then have front and back exchanged. ":paper" is the paper's
setting: a GPU and days, never run to the end.
"""

from dpc_jax.config import make_config


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return make_config("chair", variant)
