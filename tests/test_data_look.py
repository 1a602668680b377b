"""Looking before training: what show and check say of whole and of damaged sets."""

import numpy as np
import pytest
from data_trees import rotate, save_disc, write_boxes, write_renders
from PIL import Image
from scipy.spatial.transform import Rotation

from dpc_jax import outputs
from dpc_jax.data import DataSpec, __main__, dataset, load_or_render, viewpoints
from dpc_jax.data.look import checks, overview

LENS = checks.Lens(focal_length=1.875, distance=2.0)
MODELS, VIEWS, SIZE = 5, 4, 48


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A rendered set of chairs, which look different from all sides."""
    folder = tmp_path_factory.mktemp("cache")
    spec = DataSpec(
        "chair", models=MODELS, views=VIEWS, image_size=SIZE, surface_points=5000
    )
    load_or_render(spec, cache_dir=folder, processes=1)
    (path,) = folder.iterdir()
    return path


@pytest.fixture(scope="module")
def whole(cache):
    return dataset.read_cache(cache)


def damage(data, name, index, value):
    array = np.array(getattr(data, name))
    array[index] = value
    return data._replace(**{name: array})


def read_findings(data):
    return checks.check_set(data, LENS)


def restate(data, change, *, last=False):
    """The set with every rotation matrix changed, and stored as xyzw if `last`."""
    changed = Rotation.from_matrix(change(rotate(data.quaternions)))
    return data._replace(quaternions=changed.as_quat(scalar_first=not last))


WRONG = {  # how other tools and data sets store a rotation
    "inverse": lambda r: r.swapaxes(-1, -2),
    "OpenGL": lambda r: np.diag([1, -1, -1]) @ r,
}


def test_a_whole_set_has_no_fault(whole):
    assert read_findings(whole) == []
    bare = whole._replace(depths=None, surfaces=None)
    assert read_findings(bare) == []
    assert read_findings(bare._replace(quaternions=None)) == []


def test_objects_beside_the_axis_of_view_are_no_fault(tmp_path):
    spec = DataSpec("chair", models=2, views=VIEWS, image_size=SIZE, offset=0.05)
    data = load_or_render(spec, cache_dir=tmp_path, processes=1)
    assert read_findings(data) == [] and checks.list_carvable(data) == []


@pytest.mark.parametrize("name", [*WRONG, "xyzw"])
def test_poses_of_another_convention_are_told(whole, name):
    change = WRONG.get(name, lambda r: r)
    (finding,) = read_findings(restate(whole, change, last=name == "xyzw"))
    assert finding.startswith("error: ") and "poses that do not fit" in finding
    assert "expected is wxyz, object to camera" in finding


def test_poses_of_objects_that_are_all_turned_alike_are_none_of_a_fault(whole):
    """The views agree on a body, as they do if y is up."""
    turn = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    assert read_findings(restate(whole, lambda r: r @ turn)) == []


def test_a_single_stray_pose_is_told(whole):
    away = Rotation.from_euler("y", 60, degrees=True).as_quat(scalar_first=True)
    (finding,) = read_findings(damage(whole, "quaternions", (2, 3), away))
    assert finding.startswith("error: 1 of 5 objects that were tried have poses")
    assert f"{whole.names[2]} (" in finding


# what is damaged, how, and what is said of it; a mask that is gone fits no pose
ROW = (1, 2)
ONE = "1 of 20 views with"
TINY = np.pad(np.full((3, 3), 255, np.uint8), (20, SIZE - 23))
DAMAGES = [
    ("masks", ROW, 0, f"error: {ONE} an empty mask"),
    ("masks", ROW, TINY, f"warning: {ONE} a mask below 0.5%"),
    ("masks", ROW, 255, f"error: {ONE} a mask that fills the image"),
    ("masks", (*ROW, 0, slice(20, 29)), 255, f"error: {ONE} an object cut by"),
    ("masks", (*ROW, slice(20, 29), -1), 255, f"error: {ONE} an object cut by"),
    ("depths", ROW, 0, f"error: {ONE} no depth where"),
    ("depths", ROW, 5, f"error: {ONE} depth beyond"),
    ("images", ROW, 255, f"warning: {ONE} an object as white"),
]


@pytest.mark.parametrize("name, index, value, said", DAMAGES)
def test_a_damaged_view_is_named(whole, name, index, value, said):
    findings = read_findings(damage(whole, name, index, value))
    found = [text for text in findings if text.startswith(said)]
    assert len(found) == 1 and f"{whole.names[1]} view 2" in found[0], findings
    assert not any("convention" in text for text in findings)


def test_single_views_are_told(whole):
    names = ("images", "masks", "depths", "quaternions")
    single = whole._replace(**{name: getattr(whole, name)[:, :1] for name in names})
    (finding,) = read_findings(single)
    assert finding.startswith("warning: 5 of 5 objects have fewer than two views")
    assert checks.list_carvable(single) == []


def run(*arguments):
    return __main__.main([str(argument) for argument in arguments])


def test_a_set_is_listed_and_drawn(cache, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("show", cache, "--out", "sheet.png", "--models", 3) == 0
    out = capsys.readouterr().out
    assert "5 chair models, train split, 20 views of 48 x 48" in out
    assert "views per model: 4" in out and "sheet.png" in out
    with Image.open("sheet.png") as sheet:
        # three tiles for each of four views, three models
        assert sheet.size == (4 * 3 * overview.TILE, 3 * overview.TILE)
        pixels = np.asarray(sheet).reshape(-1, 3)
    for color in overview.AXES:
        assert (pixels == color).all(axis=1).sum() > 100
    assert sorted(p.name for p in tmp_path.iterdir()) == [outputs.LIST, "sheet.png"]
    assert run("check", cache) == 0
    assert "no fault found; poses fit" in capsys.readouterr().out


def test_the_axes_of_a_sheet_point_where_the_object_does():
    rotation = viewpoints.look_at_rotation(np.deg2rad(90), 0.0)  # from the left
    quaternion = viewpoints.matrix_to_quaternion(rotation)
    picture = Image.new("RGB", (overview.TILE, overview.TILE), "white")
    overview._draw_axes(picture, quaternion, LENS)
    pixels, middle = np.asarray(picture), overview.TILE / 2
    rows, columns = {}, {}
    for name, color in zip(("front", "left", "up"), overview.AXES, strict=True):
        rows[name], columns[name] = np.nonzero((pixels == color).all(axis=-1))
    # its front shows to the left of the image, its top upwards
    assert columns["front"].max() <= middle + 2 and columns["front"].min() < middle - 40
    assert rows["up"].max() <= middle + 2 and rows["up"].min() < middle - 40


def test_meshes_and_images_are_prepared_to_be_looked_at(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_boxes(tmp_path / "meshes", 3)
    assert run("show", "meshes", "--models", 2) == 0
    out = capsys.readouterr().out
    assert "Rendering train object: models, 2/2" in out and "red is the front" in out
    assert "prepared from meshes (meshes)" in out
    assert (tmp_path / "runs" / "meshes-sheet.png").exists()
    assert run("check", "meshes") == 0
    assert "3 object models" in capsys.readouterr().out
    for name in ("one", "two", "three"):
        for view in range(2):
            save_disc(tmp_path / "own" / name / f"{view}.png")
    assert run("show", "own", "--out", "own.png") == 0
    assert run("check", "own") == 0
    out = capsys.readouterr().out
    assert "(images)" in out and "no fault found; no poses" in out
    # nothing is rendered, and without poses no axes are drawn
    assert "Reading train object: models, 3/3" in out
    assert "Rendering" not in out and "red is the front" not in out
    # nothing is left behind, nothing lies between the images
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        outputs.LIST, "meshes", "own", "own.png", "runs",
    ]  # fmt: skip
    assert len(list((tmp_path / "own").rglob("*.png"))) == 6


def test_what_a_folder_is_shows_from_what_it_holds(tmp_path):
    (tmp_path / "02958343/abc").mkdir(parents=True)
    with pytest.raises(ValueError, match="render_0.png and further views"):
        overview.recognize_folder(tmp_path)
    (tmp_path / "02958343/abc/model.obj").write_text("")
    found = overview.recognize_folder(tmp_path)
    assert found == {"kind": "shapenet", "category": "car"}
    assert overview.recognize_folder(tmp_path / "02958343/abc")["kind"] == "meshes"


def test_published_renders_are_checked_with_the_views_they_have(tmp_path, capsys):
    folder = write_renders(tmp_path, ["one", "two", "three"])
    (folder / "02958343" / "two" / "render_2.png").unlink()
    assert run("check", folder) == 0
    out = capsys.readouterr().out
    assert "2 car models, 6 views" in out
    assert "warning: 1 of 3 objects left out as unusable: two" in out
    assert str(folder / "02958343" / "two") in out
    (folder / "02691156").mkdir()
    assert run("check", folder) == 1
    assert "give the folder of one of them" in capsys.readouterr().err


@pytest.mark.parametrize("text", [None, "{", "{}", '{"shards": []}'])
def test_no_set_and_a_damaged_one_are_named(tmp_path, capsys, text):
    if text is not None:
        (tmp_path / "spec.json").write_bytes(text.encode("latin-1"))
    for folder in (tmp_path, tmp_path / "absent"):
        for command in ("show", "check"):
            assert run(command, folder) == 1
            error = capsys.readouterr().err
            assert str(folder) in error and error.count("\n") == 1
