"""ShapeNet trees of both versions, made small: axes, splits, materials, damage."""

import csv

import numpy as np
import pytest
from fake_packages import BOX, write_obj

from dpc_jax.data import DataSpec, load_or_render, splits
from dpc_jax.data.sets import shapenet

SYNSET = "02958343"
NAMES = [f"{i:x}" * 8 for i in range(1, 8)]
SPEC = dict(category="car", kind="shapenet", views=1, image_size=16)
LAYOUTS = {  # (front, left, up) in the axes of the file
    "model.obj": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "models/model_normalized.obj": [[0, -1, 0], [0, 0, 1], [-1, 0, 0]],
}


def write_model(folder, layout="model.obj", *, width=0.3):
    """Long to the front, half as high, with a red nose; the folder."""
    path = folder / layout
    path.parent.mkdir(parents=True)
    body = ((BOX - 0.5) * (1, width, 0.4), (0.2, 0.2, 0.2))
    nose = ((BOX - 0.5) * (0.2, width / 2, 0.1) + (0.6, 0, -0.15), (1, 0, 0))
    boxes = [("body", *body), ("nose", *nose)]
    for name, content in write_obj(boxes, LAYOUTS[layout], path.stem).items():
        (path.parent / name).write_bytes(content)
    return folder


def write_tree(root, layout="model.obj", names=NAMES):
    for i, name in enumerate(names):
        write_model(root / SYNSET / name, layout, width=0.3 + 0.05 * i)


def load(root, cache, **changes):
    spec = DataSpec(**SPEC | {"folder": str(root)} | changes)
    return load_or_render(spec, cache_dir=cache, processes=1)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_front_turns_to_x_and_up_to_z(tmp_path, layout):
    write_tree(tmp_path, layout, NAMES[:3])
    data = load(tmp_path, tmp_path / "cache", split="test", fractions=(0, 0, 1))
    assert data.names == tuple(NAMES[:3]) and data.skipped == data.remarks == ()
    for model in range(3):
        size = np.ptp(data.surfaces[model], axis=0)
        width = 0.3 + 0.05 * model
        np.testing.assert_allclose(
            size / size[0], [1, width / 1.2, 0.4 / 1.2], atol=0.01
        )
        # only the nose reaches there, low on the front
        front = data.surfaces[model][data.surfaces[model][:, 0] > 0.48 * size[0]]
        assert len(front) and (front[:, 2] < 0).all()


def write_csv(path, rows):
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows(
            [["id", "synsetId", "subSynsetId", "modelId", "split"], *rows]
        )


def write_sides(root, **counts):
    """An all.csv that gives so many of the models to each split."""
    sides = [side for side, count in counts.items() for _ in range(count)]
    pairs = zip(NAMES, sides, strict=False)
    write_csv(root / "all.csv", [[0, SYNSET, "x", *pair] for pair in pairs])


def test_a_split_that_is_not_the_official_one_is_said_whatever_the_cache(
    tmp_path, monkeypatch
):
    monkeypatch.setitem(shapenet.OFFICIAL, SYNSET, ((3, 1, 2),))
    write_tree(tmp_path)
    for _ in range(2):  # rendered, then read from the cache
        (warning,) = load(tmp_path, tmp_path / "cache").warnings
        assert "split by seed 0 (train, val, test: 5, 1 and 1 models)" in warning
        assert "not by the official list (3, 1, 2)" in warning
        assert "cannot be compared with published ones" in warning
    write_sides(tmp_path, train=3, val=2, test=2)
    (warning,) = load(tmp_path, tmp_path / "cache").warnings
    assert "all.csv (train, val, test: 3, 2 and 2 models)" in warning
    write_sides(tmp_path, train=3, val=1, test=2)
    assert load(tmp_path, tmp_path / "cache").warnings == ()
    # Of other categories no split is published: any list will do.
    monkeypatch.delitem(shapenet.OFFICIAL, SYNSET)
    assert load(tmp_path, tmp_path / "cache").warnings == ()
    (tmp_path / "all.csv").unlink()
    (warning,) = load(tmp_path, tmp_path / "cache").warnings
    assert "not by an official list" in warning


def test_the_official_split_is_read_and_what_it_misses_is_counted(tmp_path):
    write_tree(tmp_path)
    sides = dict(zip(NAMES[:6], ["train"] * 3 + ["val"] + ["test"] * 2, strict=True))
    rows = [
        [i, "2958343", "x", name, side] for i, (name, side) in enumerate(sides.items())
    ]
    rows += [
        [8, "2691156", "x", "plane", "train"],
        [9, "2958343", "x", "gone", "train"],
    ]
    write_csv(tmp_path / "all.csv", rows)
    data = load(tmp_path, tmp_path / "cache")
    assert data.names == tuple(NAMES[:3]) and not data.skipped
    ((file, remark),) = data.remarks  # the seventh model is in no split
    assert file == str(tmp_path / "all.csv") and "leaves out 1 model" in remark
    assert "names 1 that are not there" in remark
    assert load(tmp_path, tmp_path / "cache", split="val").names == (NAMES[3],)
    (tmp_path / "splits").mkdir()
    (tmp_path / "all.csv").rename(tmp_path / "splits" / "all.csv")
    assert load(tmp_path, tmp_path / "cache").names == data.names


def test_both_forms_of_a_split_say_the_same_beside_the_set_too(tmp_path):
    sides = {"train": NAMES[:4], "val": NAMES[4:5], "test": NAMES[5:]}
    place = tmp_path / "splits"
    place.mkdir()
    for split, names in sides.items():
        (place / f"{SYNSET}_{split}.txt").write_text("\n".join(names))
    found = splits.find_split(tmp_path / "set", SYNSET)
    assert splits.read_split(found, SYNSET) == sides
    rows = [[0, SYNSET, SYNSET, n, s] for s, names in sides.items() for n in names]
    write_csv(place / "all.csv", rows)
    found = splits.find_split(tmp_path / "set", SYNSET)
    assert found.name == "all.csv" and splits.read_split(found, SYNSET) == sides


@pytest.mark.parametrize(
    "name, text, message",
    [
        ("all.csv", "id,modelId\n1,a\n", "synsetId is missing|split, synsetId"),
        ("all.csv", "synsetId,modelId,split\n1,a,train\n", "found none"),
        ("all.csv", f"synsetId,modelId,split\n{SYNSET},a,train\n{SYNSET},a,val\n",
         "a is there twice"),
        (f"{SYNSET}.file", "3\n1\n3\n2\n5\ntrain\n", "SYNSET_train.txt"),
        ("all.csv", f"synsetId,modelId,split\n{SYNSET},,train\n", "line 2 has no"),
        ("cars.txt", "a\n", "SYNSET_train.txt"),
        ("x_train.txt", "a\n", "x_val.txt beside"),
    ],
)  # fmt: skip
def test_a_split_file_that_cannot_be_used_is_named(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=message) as error:
        splits.read_split(tmp_path / name, SYNSET)
    assert name.split(".")[0].removesuffix("train") in str(error.value)


def test_damaged_models_are_skipped_and_bare_ones_remarked_upon(tmp_path, capsys):
    write_tree(tmp_path, names=NAMES[:2])
    bare = write_model(tmp_path / SYNSET / "bare") / "model.obj"
    bare.write_text(bare.read_text().partition("\n")[2])  # names no materials
    (write_model(tmp_path / SYNSET / "lost") / "model.mtl").unlink()
    plain = write_model(tmp_path / SYNSET / "plain") / "model.mtl"
    plain.write_text(plain.read_text() + "\nmap_Kd ../images/gone.jpg\n")
    (tmp_path / SYNSET / "empty").mkdir()
    (tmp_path / SYNSET / "cut").mkdir()
    (tmp_path / SYNSET / "cut" / "model.obj").write_text("v 0 0 0\nv 1 0")
    data = load(tmp_path, tmp_path / "cache", split="test", fractions=(0, 0, 1))
    assert sorted(data.names) == sorted([*NAMES[:2], "bare", "lost", "plain"])
    assert {name for name, _ in data.skipped} == {"empty", "cut"}
    assert all("model.obj" in reason for _, reason in data.skipped)
    remarks = dict(data.remarks)
    assert "no materials" in remarks["bare"] and "model.mtl" in remarks["lost"]
    assert remarks["plain"] == "lacks ../images/gone.jpg"
    text = capsys.readouterr().out
    assert "Skipped 2 of 7 models" in text and "Remarks on 3 of 7 models" in text
    grey = data.images[data.names.index("bare"), 0]
    assert np.ptp(grey.astype(int), axis=-1).max() <= 1


def test_a_category_and_a_split_that_fit_nothing_are_named(tmp_path):
    write_tree(tmp_path)
    with pytest.raises(ValueError, match="eight digits, but it is 'boat'"):
        load(tmp_path, tmp_path / "cache", category="boat")
    write_csv(tmp_path / "all.csv", [[0, SYNSET, "x", "other", "train"]])
    with pytest.raises(ValueError, match="but none of its 1 is there"):
        load(tmp_path, tmp_path / "cache")
