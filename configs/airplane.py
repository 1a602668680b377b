"""Airplanes from silhouettes without poses, in minutes on two CPU cores."""

from dpc_jax.defaults import apply_variant, default_config


def get_config(variant: str | None = None):
    """The config, or a variant of it: "paper", "naive", "known_pose"."""
    return apply_variant(default_config("airplane"), variant)
