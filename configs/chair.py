"""Chairs from silhouettes without poses: procedural, on two CPU cores.

Cost: 583 s alone on two cores, from the command to the report (commit 302da56); 3.4 GB.
Reached on 100 test chairs, means of seeds 0 to 7: pose accuracy 0.993, median error 3.1
degrees, Chamfer 3.46; on 100 final chairs (seeds 0 to 4) 0.983, 3.5, 3.47.
":paper" is the paper's setting: a GPU and days, never run to the end.
"""

from dpc_jax.config import build_config, to_config_dict


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return to_config_dict(build_config("chair", variant))
