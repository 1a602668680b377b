"""Airplanes from silhouettes without poses: procedural, on two CPU cores.

Cost: 720 s on one core beside another run. Reached on 100 test airplanes, seeds 0
to 2, November 2026: pose accuracy 0.946, 0.950, 0.938, median error 2.6, 2.7, 2.8
degrees, Chamfer 2.36, 2.33, 2.36. ":paper" is the paper's setting: a GPU and days,
never run to the end.
"""

from dpc_jax.config import make_config

# With masks one of two runs had 30 of 100 airplanes turned round in all views.
CHANGES = {"network": {"sees_mask": False}}


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return make_config("airplane", variant, CHANGES)
