"""The whole pipeline in under a minute: for tests and first looks, not for results."""

from dpc_jax.config.defaults import apply_variant, default_config


def get_config(variant: str | None = None):
    """Few, small cars and few steps; the variants of the other configs."""
    c = apply_variant(default_config("car"), variant)
    c.data.update(
        models=12, val_models=4, test_models=4, image_size=32, surface_points=10_000
    )
    c.network.update(channels=4, hidden=32, shape_hidden=32)
    c.render.update(grid=16, fine_grid=32, num_points=100, keep_levels=2)
    if c.pose.choice_grid:
        c.pose.update(choice_grid=8, choice_points=50, choice_top=4)
    c.pose.candidates = min(c.pose.candidates, 2)
    c.train.update(steps=20, warmup_steps=4)
    c.log.update(every=5, evaluate=10, checkpoint=10)
    return c
