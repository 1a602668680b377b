"""Airplanes from silhouettes without poses: procedural, on two CPU cores.

Cost: nine minutes and 1.9 GB on two cores. Reached on 100 test airplanes, seed 0, by an
earlier default, November 2026: pose accuracy 0.750, median error 3.6 degrees, Chamfer
4.76. ":paper" is the paper's setting: a GPU and days, never run to the end.
"""

from dpc_jax.config import make_config


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return make_config("airplane", variant)
