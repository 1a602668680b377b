"""Airplanes from silhouettes without poses: procedural, on two CPU cores.

Cost: about seven minutes and 1.7 GB on two cores. Not measured yet. ":paper" is the
paper's setting: a GPU and days, never run to the end.
"""

from dpc_jax.defaults import apply_variant, default_config


def get_config(variant: str | None = None):
    """The config, or a variant of it: "paper", "naive", "known_pose"."""
    return apply_variant(default_config("airplane"), variant)
