"""The checks of a config, and the records made from it.

The config is unpacked here, once; what is below takes arrays and frozen records.
"""

from pathlib import Path

import ml_collections

from dpc_jax.config.settings import Settings
from dpc_jax.data import DataSpec
from dpc_jax.data.spec import CROPS, FRONTS
from dpc_jax.learning.loop import Intervals
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.networks.encoder import count_blocks

# What may differ between a run and its continuation.
FREE_FIELDS = ("data.cache_dir", "data.processes", "log", "render.renders_at_once")

FOLDERS = ("meshes", "shapenet", "renders", "images")  # where models come from


def validate(config: ml_collections.ConfigDict):
    """Check what no later part can check better.

    Raises:
      ValueError: for a value that cannot work, naming its field.
    """

    def expect(condition, field, expected):
        value = config
        for part in field.split("."):
            value = value[part]
        if not condition:
            raise ValueError(
                f"config.{field} must be {expected}, but it is {value!r}; set another "
                f"with --config.{field}=VALUE."
            )

    data, render, pose, train = config.data, config.render, config.pose, config.train
    for field in (
        "data.models data.val_models data.test_models data.copies data.views "
        "data.surface_points network.channels network.hidden network.shape_hidden "
        "render.grid render.num_points render.keep_levels train.steps "
        "train.models_per_batch train.views_per_batch log.every"
    ).split():
        section, name = field.split(".")
        expect(config[section][name] >= 1, field, "at least 1")
    expect(pose.candidates >= 1, "pose.candidates", "at least 1 (K heads)")
    for name in ("choice_grid", "choice_points", "choice_top"):
        expect(pose[name] >= 0, f"pose.{name}", "0 or more")
    expect(config.seed >= 0, "seed", "0 or more")
    try:
        count_blocks(data.image_size)
    except ValueError as error:
        raise ValueError(f"config.data.image_size cannot be used. {error}") from None
    given = [name for name in FOLDERS if data[name]]
    expect(
        len(given) < 2,
        f"data.{given[-1]}" if given else "data.meshes",
        f"'' where data.{given[0] if given else ''} is given: one source at a time",
    )
    expect(
        bool(data.images) or train.views_per_batch <= data.views,
        "train.views_per_batch",
        f"at most data.views = {data.views}, the views there are of a model",
    )
    expect(
        bool(given) or train.models_per_batch <= data.models,
        "train.models_per_batch",
        f"at most data.models = {data.models}, the models to train on",
    )
    expect(
        data.image_size % render.grid == 0,
        "render.grid",
        f"a divisor of data.image_size = {data.image_size}, so that masks can be "
        "averaged down to it",
    )
    expect(
        not render.fine_grid
        or data.image_size % render.fine_grid == 0
        and render.fine_grid % render.grid == 0,
        "render.fine_grid",
        f"0, or a multiple of render.grid = {render.grid} that divides data.image_size "
        f"= {data.image_size}",
    )
    expect(
        not pose.choice_grid or render.grid % pose.choice_grid == 0,
        "pose.choice_grid",
        f"0 or a divisor of render.grid = {render.grid}",
    )
    for name in ("keep_start", "keep_end"):
        expect(0 < render[name] <= 1, f"render.{name}", "above 0 and at most 1")
    expect(0 < render.anneal_until <= 1, "render.anneal_until", "above 0 and at most 1")
    for name in ("sigma_start", "sigma_end"):
        expect(0 <= render[name] <= 1, f"render.{name}", "between 0 and 1")
    expect(
        render.scale_unit in ("peak", "mass"), "render.scale_unit", "'peak' or 'mass'"
    )
    expect(
        pose.spread in ("", "all", "upright"), "pose.spread", "'', 'all' or 'upright'"
    )
    expect(render.distance > 0.5, "render.distance", "above 0.5, outside the object")
    expect(render.focal_length > 0, "render.focal_length", "above 0")
    expect(train.learning_rate > 0, "train.learning_rate", "above 0")
    expect(
        0 <= train.warmup_steps <= train.steps,
        "train.warmup_steps",
        f"between 0 and train.steps = {train.steps}",
    )
    expect(data.crop in CROPS, "data.crop", f"one of {', '.join(CROPS)}")
    expect(0.1 <= data.fill <= 1, "data.fill", "between 0.1 and 1")
    expect(0 <= data.surface_voxel < 1, "data.surface_voxel", "at least 0 and below 1")
    expect(data.shapenet_front in FRONTS, "data.shapenet_front", f"one of {FRONTS}")
    expect(0 <= data.own_test <= 0.5, "data.own_test", "between 0 and 0.5")
    expect(
        not data.split_file or Path(data.split_file).is_file(),
        "data.split_file",
        "a file that exists",
    )
    for section in (*FOLDERS, "test_meshes", "ground_truth"):
        folder = data[section]
        expect(
            not folder or Path(folder).is_dir(),
            f"data.{section}",
            "a folder that exists",
        )


def make_settings(config: ml_collections.ConfigDict) -> Settings:
    """The record that the training step takes."""
    c = config
    pose_off = c.pose.known
    is_ensemble = not pose_off and c.pose.candidates > 1
    return Settings(
        steps=c.train.steps,
        models_per_batch=c.train.models_per_batch,
        views_per_batch=c.train.views_per_batch,
        grid=c.render.grid,
        fine_grid=c.render.fine_grid,
        fine_from=c.render.fine_from,
        num_points=c.render.num_points,
        num_candidates=0 if pose_off else c.pose.candidates,
        flips=c.pose.flips and is_ensemble,
        selects=c.pose.selects and is_ensemble,
        choice_grid=c.pose.choice_grid,
        choice_points=c.pose.choice_points,
        choice_top=c.pose.choice_top,
        student_weight=c.pose.student_weight,
        sigma_start=c.render.sigma_start,
        sigma_end=c.render.sigma_end,
        anneal_until=c.render.anneal_until,
        keep_start=c.render.keep_start,
        keep_end=c.render.keep_end,
        keep_levels=c.render.keep_levels,
        scale_unit=c.render.scale_unit,
        learning_rate=c.train.learning_rate,
        warmup_steps=c.train.warmup_steps,
        final_rate=c.train.final_rate,
        weight_decay=c.train.weight_decay,
        repulsion_weight=c.train.repulsion_weight,
        repulsion_points=c.train.repulsion_points,
        containment_weight=c.train.containment_weight,
        color_weight=c.train.color_weight,
        focal_length=c.render.focal_length,
        distance=c.render.distance,
        renders_at_once=c.render.renders_at_once,
        seed=c.seed,
    )


def make_network(config: ml_collections.ConfigDict) -> ShapePoseNetwork:
    """The network; what is not learned has no parameters."""
    return ShapePoseNetwork(
        num_points=config.render.num_points,
        candidates=0 if config.pose.known else config.pose.candidates,
        channels=config.network.channels,
        hidden=config.network.hidden,
        shape_hidden=config.network.shape_hidden,
        normalize=config.network.normalize,
        num_classes=_count_classes(config),
        student_width=config.network.student_width,
        has_color=config.train.color_weight > 0,
        spread=config.pose.spread,
    )


def _count_classes(config: ml_collections.ConfigDict) -> int:
    """Candidates that a selecting student has: each head, and its three half turns."""
    if not config.pose.selects or config.pose.known or config.pose.candidates == 1:
        return 0
    return config.pose.candidates * (4 if config.pose.flips else 1)


def make_data_specs(config: ml_collections.ConfigDict) -> dict[str, DataSpec]:
    """Specifications of the splits "train", "val" and "test".

    And of "own" where, beside `data.test_meshes`, objects of the training source are to
    be tested apart.
    """
    d, r = config.data, config.render
    shared = {
        "category": config.category,
        "seed": d.seed,
        "views": d.views,
        "image_size": d.image_size,
        "focal_length": r.focal_length,
        "distance": r.distance,
        "surface_points": d.surface_points,
        "surface_voxel": d.surface_voxel,
        "surface_visible": d.surface_visible,
    }
    counts = {"train": d.models, "val": d.val_models, "test": d.test_models}
    kind = next((name for name in FOLDERS if d[name]), None)
    if kind is None:
        specs = {
            split: DataSpec(split=split, models=count, **shared)
            for split, count in counts.items()
        }
    else:
        tested = d.own_test if d.test_meshes else 0.1
        fractions = (0.9 - tested, 0.1, tested)
        stretch = {"copies": d.copies, "stretch": d.stretch}
        stretch = {} if kind in ("renders", "images") else stretch
        source = {
            "kind": kind,
            "folder": d[kind],
            "split_file": d.split_file or None,
            "shapenet_front": d.shapenet_front,
            "ground_truth": d.ground_truth or None,
            "crop": d.crop,
            "fill": d.fill,
        }
        specs = {
            split: DataSpec(
                split=split,
                fractions=fractions,
                **source,
                **(stretch if split == "train" else {}),
                **shared,
            )
            for split in ("train", "val", "test")
        }
    if d.test_meshes:
        if d.own_test and kind:
            specs["own"] = specs["test"]
        specs["test"] = DataSpec(
            split="test", folder=d.test_meshes, fractions=(0, 0, 1), **shared
        )
    return specs


def make_intervals(config: ml_collections.ConfigDict) -> Intervals:
    """Steps between log lines, validations and checkpoints."""
    log = config.log
    return Intervals(log.every, log.evaluate, log.checkpoint)
