"""Rules of the systems the paper compares with: voxels, maps, poses that are drawn.

Each is (field, whether it holds, what is expected), as `checks` says it.
"""

from collections.abc import Iterator

from dpc_jax.config.sections import Config

Rule = tuple[str, bool, str]


def list_voxel_rules(config: Config) -> Iterator[Rule]:
    """Rules of voxel models, which predict a volume in place of points."""
    if config.network.shape != "voxels":
        return
    grid = config.render.grid
    yield (
        "render.grid",
        grid >= 8 and grid & (grid - 1) == 0,
        "a power of two of at least 8 with network.shape = 'voxels', because the "
        "decoder doubles 4 cells",
    )
    yield (
        "network.point_size",
        not config.network.point_size,
        "'' with network.shape = 'voxels', which has no points",
    )


def list_map_rules(config: Config) -> Iterator[Rule]:
    """Rules of maps of points at fixed views (EPCG)."""
    data, grid, until = config.data, config.render.grid, config.render.fixed_views_until
    if config.network.shape != "maps":
        expected = "0 unless network.shape = 'maps', which are seen from fixed views"
        yield "render.fixed_views_until", not until, expected
        return
    yield (
        "render.grid",
        grid >= 8 and grid & (grid - 1) == 0,
        "a power of two of at least 8 with network.shape = 'maps', because the decoder "
        "doubles 4 pixels",
    )
    for name, holds, expected in (
        ("network.point_size", not config.network.point_size, "''"),
        ("pose.known", config.pose.known, "True"),
        ("train.color_weight", not config.train.color_weight, "0"),
    ):
        why = (
            "their cells are a fifth of a pixel, and where points fall has no gradient"
        )
        yield name, holds, f"{expected} with network.shape = 'maps': {why}"
    for name, holds, expected in (
        ("render.ray_rule", config.render.ray_rule == "termination", "'termination'"),
        ("train.background_weight", not config.train.background_weight, "0"),
        ("train.silhouette_weight", config.train.silhouette_weight > 0, "above 0"),
    ):
        why = "no rays are cast, and masks are compared by their cross entropy"
        yield name, holds, f"{expected} with network.shape = 'maps': {why}"
    yield (
        "render.fixed_views_until",
        not (until and (data.images or data.renders)),
        "0 with data.images or data.renders, which have no views from fixed places",
    )


def list_sampling_rules(config: Config) -> Iterator[Rule]:
    """Rules of poses that are drawn by their probabilities (MVC)."""
    pose = config.pose
    if pose.samples:
        expected = "with pose.choice = 'sampled', which draws one head"
        yield "pose.candidates", pose.candidates > 1, f"above 1 {expected} of several"
        yield "pose.selects", pose.selects, f"True {expected} by its probability"
        yield "pose.flips", not pose.flips, f"False {expected} as it is"
        yield (
            "pose.head",
            not pose.prior_weight or pose.head == "viewpoint",
            "'viewpoint' with pose.prior_weight above 0, because the prior is one of "
            "viewpoints",
        )
        yield (
            "pose.choice_signals",
            pose.choice_signals == "silhouette",
            f"'silhouette' {expected} and compares none",
        )
    yield (
        "pose.prior_weight",
        not pose.prior_weight or pose.choice == "sampled",
        "0 unless pose.choice = 'sampled', because the prior is that of poses drawn",
    )
    yield (
        "pose.entropy_weight",
        not pose.entropy_weight or pose.choice == "sampled",
        "0 unless pose.choice = 'sampled', where heads have probabilities to learn",
    )
