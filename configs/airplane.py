"""Airplanes from silhouettes without poses: procedural, on two CPU cores.

Cost: 863 s on one core beside much other work. Reached on 100 test airplanes, seed 0,
November 2026: pose accuracy 0.740, median error 4.1 degrees, Chamfer 3.26. ":paper" is
the paper's setting: a GPU and days, never run to the end.
"""

from dpc_jax.config import make_config


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return make_config("airplane", variant)
