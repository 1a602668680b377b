"""Airplanes from silhouettes without poses: procedural, on two CPU cores.

Cost: that of `configs/chair.py`, which has the same settings.
Reached on 100 test airplanes, seeds 0 to 9: pose accuracy 0.987, median error 1.8
degrees, Chamfer 2.26; on 100 final airplanes 0.989, 1.7, 2.23 (November 2026).
":paper" is the paper's setting: a GPU and days, never run to the end.
"""

from dpc_jax.config import build_config, to_config_dict


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return to_config_dict(build_config("airplane", variant))
