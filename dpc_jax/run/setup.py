"""What a config stands for: the network, and the data sets."""

import dataclasses

from dpc_jax.config import Config
from dpc_jax.config.checks import SOURCES
from dpc_jax.config.fields import read_fold
from dpc_jax.data import DataSet, DataSpec, load_or_render
from dpc_jax.data.splits import SPLITS
from dpc_jax.files import explaining_full_disk
from dpc_jax.networks import (
    ImageEncoder,
    PoseEnsemble,
    PoseStudent,
    ShapeHead,
    ShapePoseNetwork,
)
from dpc_jax.networks.pose import (
    FOCAL_RANGE,
    TRANSLATION_RANGE,
    BoundedHead,
    PoseSelector,
)

# Visible points of a shape that is predicted, and of one that is tested: with so many
# the distance to the nearest one is that to the surface.
_VISIBLE = 2500, 100_000
_SHARED = (  # fields of `Data` that a `DataSpec` has under the same name
    *("seed", "views", "image_size", "offset", "focal_spread"),
    *("surface_points", "surface_voxel"),
)


def make_network(config: Config) -> ShapePoseNetwork:
    """The network; what is not learned has no parameters."""
    pose, layers, hidden = config.pose, config.network.layers, config.network.hidden
    blocks = 3 if layers == "paper" else 0  # 7 convolutions at every size
    slope = 0.0 if layers == "released" else 0.2
    encoder = ImageEncoder(config.network.channels, hidden, not layers, blocks)
    student_layers = hidden, 32 if layers else 256, slope
    student, extras = None, {}
    if pose.learned_heads > 1:
        student = PoseStudent(*student_layers)
        if pose.choices:
            student = PoseSelector(pose.choices, *student_layers)
    if pose.source == "sampled":
        from dpc_jax.networks.viewpoints import PoseJudge  # where asked

        extras = {"pose_encoder": encoder.clone(), "judge": PoseJudge()}
    if pose.translation:
        extras["translation"] = BoundedHead(outputs=3, bound=TRANSLATION_RANGE)
    if pose.focal_length:
        extras["focal"] = BoundedHead(outputs=1, bound=FOCAL_RANGE)
    return ShapePoseNetwork(
        encoder=encoder,
        shape=_make_shape_head(config),
        pose=_make_pose_heads(config, slope) if pose.learned_heads else None,
        student=student,
        focal_length=config.render.focal_length,
        is_tinted=not config.train.colors_move_points
        and config.train.color_weight > 0
        and config.network.shape == "points",
        sees_mask=config.network.sees_mask,
        **extras,
    )


def _make_shape_head(config):
    network, render = config.network, config.render
    has_color = config.train.color_weight > 0
    if network.shape == "voxels":
        from dpc_jax.networks.voxels import VoxelHead  # of baselines alone

        return VoxelHead(
            side=render.grid,
            has_color=has_color,
            normalize=not network.layers,
            # Given poses carve the corners away by themselves, upright ones of MVC too.
            is_contained=config.pose.source == "unknown",
        )
    if network.shape == "maps":
        from dpc_jax.networks.view_maps import ViewMapHead  # of a baseline

        return ViewMapHead(
            side=render.grid,
            focal_length=render.focal_length,
            distance=render.distance,
            normalize=not network.layers,
        )
    return ShapeHead(
        num_points=render.num_points,
        hidden=network.shape_hidden,
        has_color=has_color,
        scale_fixed=render.scale_fixed,
        point_size=network.point_size,
        first_size=render.sigma_start,
    )


def _make_pose_heads(config, slope):
    count, hidden = config.pose.learned_heads, config.network.hidden
    if config.pose.elevations:
        from dpc_jax.networks.viewpoints import ViewpointEnsemble  # where asked

        return ViewpointEnsemble(count, config.pose.elevations, hidden, slope)
    return PoseEnsemble(
        num_heads=count,
        hidden=hidden,
        # Heads that are several start spread over SO(3); not in the paper.
        spreads=not config.network.layers and count > 1,
        # A single regressor is the paper's naive one, without layers of its own.
        layers=2 if count > 1 else 0,
        slope=slope,
    )


def make_data_specs(config: Config) -> dict[str, DataSpec]:
    """Specifications of the splits "train", "val" and "test"."""
    data = config.data
    shared = {name: getattr(data, name) for name in _SHARED}
    shared |= {"category": config.category, "distance": config.render.distance}
    shared["focal_length"] = config.render.focal_length
    kind = next((name for name in SOURCES if getattr(data, name)), None)
    if kind is None:
        counts = data.models, data.val_models, data.test_models
        specs = {
            split: DataSpec(split=split, models=count, **shared)
            for split, count in zip(SPLITS, counts, strict=True)
        }
    else:
        specs = _split_folder(config, kind, shared)
    if config.network.shape == "maps":
        specs["train"] = dataclasses.replace(specs["train"], corner_views=True)
    if data.test_meshes:
        specs["test"] = DataSpec(
            split="test", folder=data.test_meshes, fractions=(0, 0, 1), **shared
        )
    for name, spec in specs.items():
        if spec.folder is None or spec.kind in ("meshes", "shapenet"):
            visible = min(_VISIBLE[name == "test"], 10 * data.surface_points)
            specs[name] = dataclasses.replace(spec, visible_points=visible)
    return specs


def load_sets(config: Config) -> dict[str, DataSet]:
    """The data sets of a run: "train", "val" and "test".

    Raises:
      ValueError: where a set cannot be used, or does not fit the config.
    """
    specs = make_data_specs(config)
    sets = {name: load_set(config, spec) for name, spec in specs.items()}
    for warning in collect_warnings(sets):
        print(f"Warning: {warning}", flush=True)
    wanted, found = config.train.models_per_batch, len(sets["train"].names)
    if wanted > found:
        raise ValueError(
            f"Expected at least train.models_per_batch = {wanted} models to train on, "
            f"but there are {found}; set --config.train.models_per_batch lower or add "
            "models."
        )
    lacking = [name for name, data in sets.items() if data.quaternions is None]
    if config.pose.aligned and lacking:
        raise ValueError(
            f"Expected poses for every image, because config.pose.source is "
            f"{config.pose.source!r}, but "
            f"the {' and '.join(lacking)} images have none; add poses.json or "
            "transforms.json to every object, or set --config.pose.source=unknown."
        )
    return sets


def load_set(config: Config, spec: DataSpec) -> DataSet:
    """A data set of a run, from its cache or prepared now; see `load_sets`."""
    data = config.data
    with explaining_full_disk(data.cache_dir):
        return load_or_render(spec, cache_dir=data.cache_dir)


def collect_warnings(sets: dict[str, DataSet]) -> list[str]:
    """What data sets warn of; each sentence once."""
    return list(dict.fromkeys(t for data in sets.values() for t in data.warnings))


def _split_folder(config, kind, shared):
    """Tenths of a folder validate and, without another folder for that, test."""
    data = config.data
    tested = 0.0 if data.test_meshes else 0.1
    source = dict(
        shared,
        kind=kind,
        folder=getattr(data, kind),
        crop=data.crop,
        fractions=(0.9 - tested, 0.1, tested),
        fold=read_fold(data.fold),
    )
    specs = {split: DataSpec(split=split, **source) for split in SPLITS}
    if kind in ("meshes", "shapenet"):  # pictures cannot be stretched
        specs["train"] = dataclasses.replace(
            specs["train"], copies=data.copies, mix=not data.copies
        )
    return specs
