"""What a data set is made of: impossible specifications, seeded splits."""

import functools

import numpy as np
import pytest
from data_trees import write_boxes

from dpc_jax.data import DataSpec, sources, split_files
from dpc_jax.data.sources import open_source
from dpc_jax.data.splits import SPLITS

TENTHS = (0.8, 0.1, 0.1)


def test_splits_hold_every_file_once_and_equal_files_together():
    paths = [f"{i:02d}.obj" for i in range(23)]
    groups = [i // 2 for i in range(23)]
    split = functools.partial(split_files, fractions=(0.7, 0.15, 0.15))
    sides = split(paths, seed=3, groups=groups)
    assert sorted(sum(sides, [])) == paths
    assert all(sides)
    for first, second in zip(paths[0:22:2], paths[1:22:2], strict=True):
        assert sum(first in side and second in side for side in sides) == 1
    assert sides == split(paths[::-1], seed=3, groups=groups[::-1])
    assert sides != split(paths, seed=4, groups=groups)
    assert split_files(paths, fractions=(0, 0, 1), seed=0) == ([], [], paths)


def test_every_side_with_a_share_gets_a_file_as_far_as_they_last():
    for count in (3, 5, 9):
        assert all(split_files(range(count), fractions=TENTHS, seed=0))
    assert all(split_files(range(2), fractions=(0.5, 0, 0.5), seed=0)[::2])
    assert split_files(range(1), fractions=TENTHS, seed=0) == ([0], [], [])


def test_over_all_folds_every_family_is_tested_once_and_never_trained_on():
    paths = list(range(23))
    groups = [path // 3 for path in paths]  # 8 families, the last of two
    split = functools.partial(split_files, fractions=TENTHS, seed=4)
    sides = [split(paths, groups=groups, fold=(i, 5)) for i in range(5)]
    assert sorted(path for side in sides for path in side[2]) == paths
    for train, val, test in sides:
        families = [{path // 3 for path in side} for side in (train, val, test)]
        assert sorted(train + val + test) == paths
        assert sum(map(len, families)) == 8
        assert [len(found) for found in families[1:]] in ([1, 1], [1, 2])
    with pytest.raises(ValueError, match="there are 3 and data.fold asks for 5"):
        split(range(3), fold=(0, 5))


def test_a_small_set_is_completed_by_copies_and_procedural_shapes(
    tmp_path, monkeypatch
):
    all_train = {"folder": str(write_boxes(tmp_path, 4)), "fractions": (1, 0, 0)}
    spec = DataSpec("car", copies=0, mix=True, **all_train)
    models = open_source(spec).list_models()
    assert [model.copy for model in models[:300]] == sorted(4 * list(range(75)))
    assert len({model.name for model in models}) == len(models) == 600
    own = DataSpec("car", models=300)  # the same that a procedural set would have
    assert models[300:] == open_source(own).list_models()
    meshes = [open_source(spec).make_mesh(models[i]) for i in (0, 599)]
    assert len(meshes[0].faces) == 12 < len(meshes[1].faces)
    for copy in models[4:24:4]:
        extents = open_source(spec).make_mesh(copy).extents
        ratios = extents / meshes[0].extents
        assert 1e-3 < np.ptp(ratios / ratios[0]) < 1.15 / 0.85

    lamps = DataSpec("lamp", copies=0, mix=True, **all_train)  # no such shapes
    assert len(open_source(lamps).list_models()) == 300
    chosen = DataSpec("car", copies=2, **all_train)
    assert len(open_source(chosen).list_models()) == 2 * 4
    monkeypatch.setattr(sources, "FEW", 4)  # a large set is left as it is
    assert [model.copy for model in open_source(spec).list_models()] == [0] * 4


def test_procedural_splits_and_seeds_never_share_a_shape():
    seeds = set()
    for split in SPLITS:
        for seed in range(3):
            spec = DataSpec("car", models=50, split=split, seed=seed)
            seeds |= {source.seed for source in open_source(spec).list_models()}
    assert len(seeds) == 9 * 50


def test_an_empty_split_of_a_folder_is_named(tmp_path):
    folder = str(write_boxes(tmp_path, 2))
    spec = DataSpec("car", folder=folder, split="val", fractions=(1, 0, 1))
    with pytest.raises(ValueError, match="val split of .* none among its 2"):
        open_source(spec).list_models()


@pytest.mark.parametrize(
    "kind, made, message",
    [
        ("meshes", None, "set is not a folder"),
        ("meshes", "a", "Expected .*mesh files .* in .*set"),
        ("images", "a", "folders of images .* in .*set"),
        ("renders", "02958343/a", "render_0.png.*in .*02958343"),
        ("shapenet", "a", "02958343 .car. in"),
        ("shapenet", "02958343/a", "model.obj or MODEL/models/model_normalized"),
    ],
)
def test_a_folder_without_models_of_its_kind_is_named(tmp_path, kind, made, message):
    if made is not None:
        (tmp_path / "set" / made).mkdir(parents=True)
    spec = DataSpec("car", kind=kind, folder=str(tmp_path / "set"))
    with pytest.raises(ValueError, match=message):
        open_source(spec).list_models()
