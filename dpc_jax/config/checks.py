"""Which values of a config can work, alone and together."""

import dataclasses

from dpc_jax.config.fields import COUNTABLE
from dpc_jax.config.sections import Config

SOURCES = ("meshes", "shapenet", "renders", "images")  # folders that models come from


def check(config: Config):
    """Check every field, and the fields that depend on each other.

    Raises:
      ValueError: for a value that cannot work, naming its field.
    """
    _check_alone(config, "config")
    for name, holds, expected in _list_rules(config):
        section, field = name.split(".")
        value = getattr(getattr(config, section), field)
        _expect(holds, f"config.{name}", value, expected)


def _check_alone(section, path):
    for field in dataclasses.fields(section):
        value, name = getattr(section, field.name), f"{path}.{field.name}"
        if dataclasses.is_dataclass(value):
            _check_alone(value, name)
        elif "allowed" in field.metadata:
            for allowed in (COUNTABLE, field.metadata["allowed"]):
                _expect(allowed.holds(value), name, value, allowed.text)


def _expect(holds, name, value, expected):
    if not holds:
        raise ValueError(
            f"{name} must be {expected}, but it is {value!r}; set another with "
            f"--{name}=VALUE."
        )


def _list_rules(config):
    """(field, whether it fits the others, what is expected) of each rule."""
    data, render, train = config.data, config.render, config.train
    given = [name for name in SOURCES if getattr(data, name)]
    if len(given) > 1:
        expected = f"'' where data.{given[0]} is given: one source at a time"
        yield f"data.{given[-1]}", False, expected
    yield (
        "train.views_per_batch",
        bool(data.images) or train.views_per_batch <= data.views,
        f"at most data.views = {data.views}, the views of a model",
    )
    yield (
        "train.models_per_batch",
        bool(given) or train.models_per_batch <= data.models,
        f"at most data.models = {data.models}, the models to train on",
    )
    low, high = config.pose.elevation_low, config.pose.elevation_high
    above = f"above pose.elevation_low = {low} degrees"
    yield "pose.elevation_high", low < high, above
    yield (
        "run.devices",
        not config.run.devices or train.models_per_batch % config.run.devices == 0,
        "0, or a divisor of train.models_per_batch = "
        f"{train.models_per_batch}, so that all devices have as many objects",
    )
    yield (
        "data.fold",
        bool(given) and not data.test_meshes or not data.fold,
        "'' unless there is a folder of models (data.meshes, say) that is split by "
        "seed and tested on itself",
    )
    size, grid, fine = data.image_size, render.grid, render.fine_grid
    whole = f"data.image_size = {size}, so that masks can be averaged down to it"
    yield "render.grid", size % grid == 0, f"a divisor of {whole}"
    yield (
        "render.fine_grid",
        not fine or size % fine == 0 and fine % grid == 0,
        f"0, or a multiple of render.grid = {grid} that divides data.image_size = "
        f"{size}",
    )
    yield from _list_system_rules(config)
    yield from _list_signal_rules(config)


def _list_system_rules(config):
    """Rules of the systems the paper compares with: voxels, maps, drawn poses."""
    train, render = config.train, config.render
    shape, grid = config.network.shape, render.grid
    is_sampled = config.pose.source == "sampled"
    for name, holds, expected in (
        ("num_heads", config.pose.num_heads > 1, "above 1"),
        ("head", config.pose.head == "viewpoint", "'viewpoint'"),
        ("student", config.pose.student == "selects", "'selects'"),
    ):
        why = "with pose.source = 'sampled', which draws one of several upright heads"
        yield f"pose.{name}", not is_sampled or holds, f"{expected} {why}"
    if shape != "points":
        yield (
            "render.grid",
            grid >= 8 and grid & (grid - 1) == 0,
            f"a power of two of at least 8 with network.shape = {shape!r}, because the "
            "decoder doubles a side of 4",
        )
        yield (
            "network.point_size",
            not config.network.point_size,
            f"'' with network.shape = {shape!r}, whose points have no size",
        )
    if shape != "maps":
        return
    expected = (
        "'points' or 'voxels' with data.images or data.renders, which are rendered "
        "already: maps are learned from fixed views"
    )
    yield "network.shape", not (config.data.images or config.data.renders), expected
    for name, holds, expected in (
        ("pose.source", config.pose.known, "'given'"),
        ("train.color_weight", not train.color_weight, "0"),
        ("render.ray_rule", render.ray_rule == "termination", "'termination'"),
        ("train.background_weight", not train.background_weight, "0"),
        ("train.silhouette_weight", train.silhouette_weight > 0, "above 0"),
    ):
        why = "points are drawn into pixels, no rays are cast, and masks are compared"
        yield name, holds, f"{expected} with network.shape = 'maps': {why}"


def _list_signal_rules(config):
    """Rules of the signals that are compared, and of what a view's camera is."""
    data, train = config.data, config.train
    others = train.depth_weight + train.color_weight
    yield (
        "train.silhouette_weight",
        train.silhouette_weight + others > 0,
        "above 0 where train.depth_weight and train.color_weight are 0, so that there "
        "is something to learn from",
    )
    others = train.silhouette_weight + train.depth_weight
    yield (
        "train.colors_move_points",
        others > 0 or train.colors_move_points,
        "True where colours alone are compared, because nothing else would teach the "
        "shape",
    )
    yield (
        "train.depth_weight",
        not (train.depth_weight and data.images),
        "0 with data.images, which come without depths",
    )
    is_free = not (data.images or data.renders)
    for name in ("offset", "focal_spread"):
        expected = "0 with data.images or data.renders, which are rendered already"
        yield f"data.{name}", is_free or not getattr(data, name), expected
