"""Airplanes from silhouettes without poses: procedural, on two CPU cores.

Cost: 452 s alone on two cores, from the command to the report (commit 94acf0d); 3.3 GB.
Reached on 100 test airplanes, means of seeds 0 to 9: pose accuracy 0.956 (one 0.824,
the others 0.956 to 0.980), median error 1.9 degrees, Chamfer 2.15; on 100 final
airplanes 0.950, 1.8, 2.13. Runs of one seed part by rounding.
":paper" is the paper's setting: a GPU and days, never run to the end.
"""

from dpc_jax.config import build_config, to_config_dict

# With both (seed 2) final renders have a pose accuracy of 0.960 instead of 0.980 and a
# visible Chamfer distance of 2.33 instead of 2.14; photographs 0.914 instead of 0.548.
CHANGES = {"network": {"sees_mask": False}, "train": {"framed_views": False}}


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return to_config_dict(build_config("airplane", variant, CHANGES))
