"""Chairs from silhouettes without poses: procedural, on two CPU cores.

Cost: 611 to 735 s on one core beside other work, 1.6 GB. Reached on 100 test chairs,
seeds 0 to 2, November 2026: pose accuracy 0.988, 0.960, 0.966, median error 3.9, 3.8,
3.8 degrees, Chamfer 3.57, 3.61, 3.54, all with `pose.choice_top=3`, which is a tenth
faster. ":paper" is the paper's setting: a GPU and days, never run to the end.
"""

from dpc_jax.config import make_config


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return make_config("chair", variant)
