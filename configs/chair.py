"""Chairs from silhouettes without poses: procedural, on two CPU cores.

Cost: about that of `configs/car.py`; 3.4 GB.
Reached on 100 test chairs, seeds 0 to 9: pose accuracy 0.996, median error 3.1 degrees,
Chamfer 3.45; on 100 final chairs 0.984, 3.5, 3.47 (November 2026).
":paper" is the paper's setting: a GPU and days, never run to the end.
"""

from dpc_jax.config import build_config, to_config_dict


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return to_config_dict(build_config("chair", variant))
