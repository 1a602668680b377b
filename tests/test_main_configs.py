"""Every config builds in every variant, and in those that combine."""

import json

import pytest
from config_files import FOLDER, NAMES, change, load, parameter_shapes

from dpc_jax.config import (
    VARIANTS,
    Config,
    check,
    from_fields,
    list_shipped,
    locate_config,
    to_config_dict,
    to_json,
)
from dpc_jax.learning.schedules import list_spans
from dpc_jax.run.setup import make_data_specs


@pytest.mark.parametrize(
    "name, variant",
    [(name, None) for name in NAMES]
    + [("car", variant) for variant in VARIANTS]
    + [("debug", "paper")]
    + [("car", f"paper,{name}") for name in VARIANTS if name != "paper"],
)
def test_every_config_builds_in_every_variant(name, variant):
    config = load(name, variant)
    check(config)
    specs = make_data_specs(config)
    output, _ = parameter_shapes(config)

    if config.network.shape == "points":
        assert output["points"].shape == (2, config.render.num_points, 3)
    elif config.network.shape == "maps":
        assert output["points"].shape == (2, 8 * config.render.grid**2, 3)
    else:
        assert output["cells"].shape == (2, *[config.render.grid] * 3)
        assert "points" not in output
    if config.network.shape != "points":  # one program: there is nothing to leave out
        assert len(list_spans(config.render, steps=config.train.steps)) == 1
    if config.pose.learned_heads:
        assert output["candidates"].shape == (2, config.pose.learned_heads, 4)
    assert set(specs) == {"train", "val", "test"}
    assert all(spec.image_size == config.data.image_size for spec in specs.values())
    assert config.train.views_per_batch <= specs["train"].views
    assert config.log.every >= 1 and config.log.checkpoint >= 1
    assert config.variant == (variant or "")


def test_the_name_of_a_shipped_config_becomes_its_path():
    assert list_shipped() == {path.stem: path for path in FOLDER.glob("*.py")}
    assert locate_config("car:paper,64") == f"{FOLDER}/car.py:paper,64"
    for other in ("configs/car.py:paper", "bus"):
        assert locate_config(other) == other


def test_variants_combine_in_any_order():
    config = load("car", "known_pose, paper")
    assert config == load("car", "paper,known_pose")
    assert config.pose.known and config.render.grid == 64
    assert config.variant == "paper,known_pose"
    assert load("car", "naive,paper").pose.num_heads == 1


@pytest.mark.parametrize(
    "variant, says",
    [
        ("naive,known_pose", "known_pose and naive exclude each other"),
        ("32,paper,128", "128 and 32 exclude each other"),
        ("paper,paper", "paper is given twice"),
        ("paper,", "it has an empty name"),
        ("fast", "paper, naive, known_pose.*but it has fast"),
    ],
)
def test_variants_that_mean_nothing_are_refused(variant, says):
    with pytest.raises(ValueError, match=says):
        load("car", variant)


@pytest.mark.parametrize("name", NAMES)
def test_a_config_survives_the_command_line_and_the_workdir(name):
    config = load(name, "paper")
    assert from_fields(to_config_dict(config).to_dict()) == config
    assert from_fields(json.loads(to_json(config))) == config


def test_a_workdir_from_before_a_field_has_its_default():
    fields = json.loads(to_json(load("car")))
    del fields["render"]["anneal_until"], fields["log"]
    assert from_fields(fields) == load("car")


@pytest.mark.parametrize(
    "change, says",
    [
        ({"render": {"gird": 32}}, "config.render .* but it has gird"),
        ({"render": {"grid": "32"}}, "config.render.grid must be of type int"),
        ({"render": {"grid": True}}, "config.render.grid must be of type int"),
        ({"render": 32}, "config.render must be a section"),
        ({"category": None}, "config.category must be of type str"),
        ({}, "must have the field category"),
    ],
)
def test_a_workdir_with_fields_that_are_none_of_ours_is_refused(change, says):
    with pytest.raises(ValueError, match=says):
        from_fields(({"category": "car"} if change else {}) | change)


def test_whole_numbers_stand_for_real_ones():
    read = from_fields({"category": "car", "render": {"focal_length": 2}})
    assert read == change(Config("car"), "render", focal_length=2.0)


def test_labels_teach_an_ensemble_only_where_a_student_selects_from_it():
    assert load("car", "gt_pose").pose.choices == 8
    _, shapes = parameter_shapes(load("car", "paper,gt_pose"))
    assert {name.split("/")[0] for name in shapes} == {"encoder", "shape", "pose"}
    assert shapes["pose/heads/Dense_0/kernel"] == (1, 1024, 4)  # as the naive one


def test_the_released_codes_choices_are_laid_over_the_papers():
    config = load("chair", "released,paper")
    assert (config.data.image_size, config.render.grid) == (128, 64)
    assert config.render.num_points == 8000 and config.train.steps == 600_000
    _, shapes = parameter_shapes(config)
    assert sum(len(s) == 4 for s in shapes.values()) == 9  # convolutions, to 4×4
    # 3.0 to 0.2 voxels, 20 beside half the squares summed over 64² pixels.
    assert config.render.sigma_start * 64 == 3 and config.render.sigma_end * 64 == 0.2
    assert config.pose.student_weight * 64**2 == 40
    assert config.train.models_per_batch * config.train.views_per_batch == 32


def test_a_folder_of_meshes_is_split_unless_another_one_is_tested_on():
    config = change(load("car"), "data", meshes=".")
    check(change(config, "data", fold="4/5"))
    specs = make_data_specs(config).values()
    assert {(s.folder, s.fractions) for s in specs} == {(".", (0.8, 0.1, 0.1))}
    assert [(s.mix, s.copies) for s in specs] == [(True, 0), (False, 1), (False, 1)]
    # What is visible of the tested surfaces is dense.
    assert [s.visible_points for s in specs] == [2500, 2500, 100_000]
    folds = make_data_specs(change(config, "data", fold="2/5"))
    assert {spec.fold for spec in folds.values()} == {(2, 5)}
    changed = change(config, "data", test_meshes="others", copies=3)
    specs = make_data_specs(changed).values()
    assert [s.folder for s in specs] == [".", ".", "others"]
    assert [s.fractions[2] for s in specs] == [0, 0, 1]
    assert [(s.mix, s.copies) for s in specs] == [(False, 3), (False, 1), (False, 1)]


@pytest.mark.parametrize("source", ["shapenet", "renders", "images"])
def test_every_source_reaches_all_splits_with_what_belongs_to_it(source):
    config = load("car")
    fields = {source: ".", "crop": "view"}
    config = change(config, "data", **fields, surface_voxel=0.01)
    if source != "images":
        check(config)
    specs = make_data_specs(config)
    assert set(specs) == {"train", "val", "test"}
    for split, spec in specs.items():
        assert (spec.kind, spec.folder, spec.split) == (source, ".", split)
        assert spec.crop == "view" and spec.models is None
        assert spec.surface_voxel == 0.01
        assert bool(spec.visible_points) == (source == "shapenet")
