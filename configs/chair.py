"""Chairs from silhouettes without poses: procedural, on two CPU cores.

Cost: 681 s on one core beside other work, 1.6 GB. Reached on 100 test chairs, seeds 0
to 2, November 2026: pose accuracy 0.970, 0.978, 0.970, median error 5.2, 4.7, 4.4
degrees, Chamfer 3.57, 3.53, 3.51, trained before masks; seed 0 with them 0.988, 5.2,
3.57. ":paper" is the paper's setting: a GPU and days, never run to the end.
"""

from dpc_jax.config import make_config


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return make_config("chair", variant)
