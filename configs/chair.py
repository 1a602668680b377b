"""Chairs from silhouettes without poses: procedural, on two CPU cores.

Cost: 326 s on one core beside other work, 1.6 to 3.1 GB. Reached on 100 test chairs,
seeds 0 to 2, November 2026: pose accuracy 0.894, 0.854, 0.760, median error 6.0, 6.4,
6.8 degrees, Chamfer 3.72, 4.12, 4.32. A kind of chair may be wrong as a whole, with
seed 2 most armchairs. ":paper" is the paper's setting: a GPU and days, never run to
the end.
"""

from dpc_jax.config import make_config


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return make_config("chair", variant)
