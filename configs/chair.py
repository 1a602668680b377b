"""Chairs from silhouettes without poses: procedural, on two CPU cores.

Cost: 453 s alone on two cores, from the command to the report; 3.3 GB. Reached on 100
test chairs, seed 0: pose accuracy 0.978, median error 4.0 degrees, Chamfer 3.63; seeds
0 to 2 on one device with `pose.choice_top=3`, which is a tenth faster: 0.988, 0.960,
0.966; 3.9, 3.8, 3.8; 3.57, 3.61, 3.54. ":paper" is the paper's setting: a GPU and days,
never run to the end.
"""

from dpc_jax.config import make_config


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return make_config("chair", variant)
