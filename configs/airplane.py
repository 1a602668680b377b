"""Airplanes from silhouettes without poses: procedural, on two CPU cores.

Cost: seven to eight minutes and 1.7 GB on two cores. It does not work yet: seed 0 at
3000 of its 4500 steps, November 2026, on 100 test airplanes: pose accuracy 0.33,
median error 63 degrees, Chamfer 16.5; the repulsion blows the thin shapes apart
(docs/results.md). ":paper" is the paper's setting: a GPU and days, never run to the
end.
"""

from dpc_jax.defaults import apply_variant, default_config


def get_config(variant: str | None = None):
    """The config, or a variant of it: "paper", "naive", "known_pose"."""
    return apply_variant(default_config("airplane"), variant)
