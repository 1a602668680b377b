"""The whole pipeline in a minute, once compiled: for tests and a look, not results."""

from dpc_jax.config import build_config, replace_fields, to_config_dict

SMALL = {
    "data": dict(
        models=12,
        val_models=4,
        test_models=4,
        copies=1,
        image_size=32,
        surface_points=10_000,
    ),
    "network": dict(channels=4, hidden=32, shape_hidden=32),
    "render": dict(grid=16, fine_grid=32, num_points=100),
    "train": dict(steps=20),
    "log": dict(every=5, evaluate=10, checkpoint=10),
}


def get_config(variant: str | None = None):
    """Few, small cars and few steps; the variants of the other configs."""
    config = replace_fields(build_config("car", variant), SMALL)
    heads, top = config.pose.num_heads, config.pose.choice_top
    pose = {"num_heads": min(heads, 2), "choice_top": min(top, 2)}
    return to_config_dict(replace_fields(config, {"pose": pose}))
