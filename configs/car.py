"""Cars from silhouettes without poses: procedural, on two CPU cores.

Cost: five to fifteen minutes on two cores, command to report; 4 GB.
Reached on 100 test cars, seeds 0 to 9: pose accuracy 0.976, median error 2.3 degrees,
Chamfer 3.07, visible 2.89; on 100 final cars 0.956, 2.5, 3.32, 3.17 (November 2026).
":paper" is the paper's setting: a GPU and days, never run to the end.
"""

from dpc_jax.config import build_config, to_config_dict

CHANGES = {
    # A large surface: holes between 2000 points are a tenth of the error.
    # Half the width of the layer before them keeps the parameters and the time.
    # Each half of them has to explain the images: few are left where none shows; with
    # a quarter until the fine grid, surfaces are better (docs/log.md).
    "render": {"num_points": 4000, "keep_start": 0.25, "keep_end": 0.5},
    "network": {"shape_hidden": 256},
    # A truck turned round has the silhouette of a car, and a car from behind nearly
    # that of one from the front; lamps tell them apart.
    "pose": {"common_frame": "colors"},
    # Spreads the points over the surface of a solid body; thin shapes it blows apart.
    "train": {"repulsion_weight": 12.0},
}


def get_config(variant: str | None = None):
    """The config, or variants of it (`dpc_jax.config.VARIANTS`), with commas."""
    return to_config_dict(build_config("car", variant, CHANGES))
