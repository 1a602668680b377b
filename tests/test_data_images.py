"""A user's own images: masks, framing, poses, and what is left out."""

import json
import re
import sys

import numpy as np
import pytest
from data_trees import (
    draw_balls,
    look_at,
    rotate,
    sample_balls,
    share_inside,
    write_photos,
)
from PIL import Image
from scipy.spatial.transform import Rotation

from dpc_jax.data import DataSpec, load_or_render, viewpoints
from dpc_jax.data.sets import framing, pose_files
from dpc_jax.data.sets.image_folder import read_views
from dpc_jax.data.sets.pictures import read_picture

LENS = np.array([[120.0, 0, 40], [0, 120.0, 40], [0, 0, 1]])


def load(place, folder="set", **changes):
    """The data set of a folder, which is read into the cache beside it."""
    spec = dict(category="car", kind="images", image_size=32, fractions=(0, 0, 1))
    spec = DataSpec(**spec | {"folder": str(place / folder), "split": "test"} | changes)
    return load_or_render(spec, cache_dir=place / "cache", processes=1)


def write_object(folder, *, views=2, seed=0):
    """Upright views of the balls from a distance of 2; their rotations."""
    folder.mkdir(parents=True, exist_ok=True)
    rotations = []
    for view in range(views):
        angle = 2 * np.pi * view / views + seed
        position = 2 * np.array([np.cos(angle), np.sin(angle), 0.3])
        rotations.append(look_at(position))
        rgba, _ = draw_balls(rotations[-1], position, LENS, (80, 80))
        Image.fromarray(rgba).save(folder / f"view{view}.png")
    return rotations


def write_set(place, views=2):
    """Three objects: the folder of each, and its rotations."""
    places = [place / "set" / name for name in "abc"]
    return [(p, write_object(p, views=views, seed=i)) for i, p in enumerate(places)]


def write_quaternions(folder, rotations):
    poses = {
        f"view{i}.png": viewpoints.matrix_to_quaternion(rotation).tolist()
        for i, rotation in enumerate(rotations)
    }
    (folder / "poses.json").write_text(json.dumps(poses))


def test_objects_of_any_number_of_views_make_one_set(tmp_path):
    for name, views in (("a", 1), ("b", 3), ("c", 7)):
        write_object(tmp_path / "set" / name, views=views)
    data = load(tmp_path)
    assert data.names == ("a", "b", "c") and data.counts.tolist() == [1, 3, 7]
    assert data.images.shape == (3, 7, 32, 32, 3)
    assert data.quaternions is data.surfaces is data.depths is None
    # images side by side are objects of one view
    data = load(tmp_path, "set/c")
    assert data.names == tuple(f"view{i}" for i in range(7))
    assert (data.counts == 1).all()


def test_alpha_and_mask_files_say_the_same(tmp_path):
    write_set(tmp_path)
    first = load(tmp_path)
    for path in (tmp_path / "set").glob("*/*.png"):
        image = Image.open(path)
        image.convert("RGB").save(path)
        image.getchannel("A").save(path.with_stem(f"{path.stem}_mask"))
    second = load(tmp_path)
    np.testing.assert_array_equal(first.masks, second.masks)
    np.testing.assert_array_equal(first.images, second.images)
    # the room behind the object is gone
    assert (np.asarray(first.images)[np.asarray(first.masks) == 0] == 255).all()


@pytest.mark.parametrize("crop", ["object", "view", "none"])
def test_crops_center_the_object_and_fill_the_frame(tmp_path, crop):
    """What lies beyond the border of an image is empty: one object reaches there."""
    folder = tmp_path / "set" / "a"
    folder.mkdir(parents=True)
    corners = {0: (0, 10, 40, 20), 1: (50, 8, 20, 30)}  # left, top, width, height
    for view, (left, top, width, height) in corners.items():
        rgba = np.zeros((60, 90, 4), np.uint8)
        rgba[top : top + height, left : left + width] = (10, 200, 30, 255)
        Image.fromarray(rgba).save(folder / f"{view}.png")
    data = load(tmp_path, crop=crop, fill=0.8)
    side = {"object": (50, 50), "view": (50, 37.5), "none": (60, 60)}[crop]
    for view, (_, _, width, height) in corners.items():
        mask = data.masks[0, view] / 255.0
        scale = 32 / side[view]
        # areas are exact but for the samples, 2 to 4 per pixel and axis, at the rim
        area = width * height * scale**2
        if crop != "none":
            assert abs(mask.sum() - area) < 0.12 * 2 * (width + height) * scale
            rows, columns = np.mgrid[:32, :32] + 0.5
            middle = (mask * rows).sum() / area, (mask * columns).sum() / area
            np.testing.assert_allclose(middle, 16, atol=0.4)
        assert (data.images[0, view][mask == 1] == [10, 200, 30]).all()


def test_a_large_photograph_gives_the_picture_of_a_small_one(tmp_path):
    rows, columns = np.mgrid[:64, :64]
    small = np.zeros((64, 64, 4), np.uint8)
    small[..., :3] = np.stack([4 * rows, 4 * columns, 0 * rows], -1)
    small[(rows - 30) ** 2 + (columns - 33) ** 2 < 400, 3] = 255
    large = small.repeat(15, axis=0).repeat(15, axis=1)
    for name, pixels in (("small", small), ("large", large)):
        (tmp_path / "set" / name).mkdir(parents=True)
        Image.fromarray(pixels).save(tmp_path / "set" / name / "0.png")
    data = load(tmp_path, image_size=16)
    masks, images = (np.asarray(a).astype(int) for a in (data.masks, data.images))
    # the small one is smoothed over its pixels, 3 of which make one of the picture's
    assert np.abs(masks[0] - masks[1]).mean() < 5
    assert np.abs(images[0] - images[1]).mean() < 4
    assert abs(masks[0].sum() / masks[1].sum() - 1) < 0.01


def write_model(place, model, *, lens="PINHOLE 120 90 130 130 60 45"):
    """A model of COLMAP in text, from the transforms.json of an object, which goes."""
    poses = pose_files.read_poses([place / "transforms.json"])
    (place / "transforms.json").unlink()
    lines = []
    for number, (path, pose) in enumerate(poses.items(), start=1):
        turn = Rotation.from_matrix(pose.rotation).as_quat(scalar_first=True)
        shift = -pose.rotation @ pose.position
        numbers = " ".join(repr(float(n)) for n in (*turn, *shift))
        lines += [f"{number} {numbers} 1 {path.name}", ""]
    model.mkdir(parents=True, exist_ok=True)
    (model / "cameras.txt").write_text(f"1 {lens}\n")
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    (model / "points3D.txt").write_text("")


@pytest.mark.parametrize("where, is_binary", [("", False), ("sparse/0", True)])
def test_a_model_of_colmap_gives_the_views_of_the_same_transforms(
    where, is_binary, tmp_path
):
    for name in "abc":
        write_photos(tmp_path / "set" / name, views=3, seed=ord(name))
    expected = load(tmp_path)
    for name in "abc":
        place = tmp_path / "set" / name
        write_model(place, place / where)
        if is_binary:
            pycolmap = pytest.importorskip("pycolmap")
            pycolmap.Reconstruction(str(place / where)).write_binary(str(place / where))
            for file in (place / where).glob("*.txt"):
                file.unlink()
            (place / "images").mkdir()
            for image in place.glob("*.png"):
                image.rename(place / "images" / image.name)
    found = load(tmp_path)
    for name in ("masks", "quaternions"):
        pairs = zip(getattr(found, name), getattr(expected, name), strict=True)
        for ours, theirs in pairs:  # float64 of the same numbers; masks round
            np.testing.assert_allclose(
                ours, theirs, atol=1 if name == "masks" else 1e-6
            )


def test_what_cannot_be_read_of_colmap_is_a_sentence(tmp_path, monkeypatch):
    place = tmp_path / "set" / "a"
    write_photos(place, views=2)
    write_model(place, place, lens="SIMPLE_RADIAL 120 90 130 60 45 0.1")
    with pytest.raises(
        ValueError, match=r"png is distorted; .* image_undistorter makes"
    ):
        pose_files.read_poses(pose_files.find_pose_files(place))
    (place / "cameras.txt").write_text("1 PINHOLE wide")
    with pytest.raises(ValueError, match="Expected poses in .* cannot be used"):
        pose_files.read_poses([place / "images.txt"])
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(ValueError, match=r"pip install 'dpc_jax\[colmap\]'"):
        pose_files.read_poses([place / "images.txt"])


def test_quaternions_come_with_their_views_and_a_view_without_one_is_left_out(tmp_path):
    objects = write_set(tmp_path, views=3)
    for place, rotations in objects:
        write_quaternions(place, rotations[:2])
    data = load(tmp_path)
    for (_, rotations), quaternions in zip(objects, data.quaternions, strict=True):
        np.testing.assert_allclose(rotate(quaternions), rotations[:2], atol=1e-6)
    assert "a pose of" in data.remarks[0][1] and "view2.png" in data.remarks[0][1]


@pytest.mark.parametrize("fields", [{}, {"convention": "opencv", "axes": 1}])
def test_transforms_give_views_that_fit_one_object(tmp_path, fields):
    """With place and lens known, one scale and one middle explain all views."""
    for i, name in enumerate("abc"):
        write_photos(tmp_path / "set" / name, views=6, seed=i, **fields)
    data = load(tmp_path, image_size=64)
    points = sample_balls()
    for model in range(3):
        # the size is free: it is the one at which the largest view fills the frame
        best = max(
            np.linspace(0.8, 1.5, 36),
            key=lambda s: min(
                share_inside(
                    s * points, data.quaternions[model, v], data.masks[model, v]
                )
                - 0.02 * (1.5 - s)
                for v in range(6)
            ),
        )
        for view in range(6):
            pose, mask = data.quaternions[model, view], data.masks[model, view]
            # the middle is found from the boxes of masks, not quite that of the balls
            assert share_inside(best * points, pose, mask) > 0.9
            # and the mask has no room for much more
            assert share_inside(1.35 * best * points, pose, mask) < 0.9
        extent = [(m > 127).any(0).sum() / 64 for m in data.masks[model]]
        assert 0.6 < max(extent) <= 0.9
        # Cameras are held upright, and so the views are: their rows are level.
        turns = rotate(data.quaternions[model])
        np.testing.assert_allclose(turns[:, 0, 2], 0, atol=1e-6)


@pytest.mark.parametrize("rolls", [(0.0, 0, 0), (0.1, 0.05, -0.15), (0.1, 1.7, -1.2)])
def test_views_are_upright_where_cameras_are(rolls):
    """They look down, and past the object by some 17 degrees."""
    mask = np.zeros((80, 80), bool)
    mask[30:50, 30:50] = True
    poses = []
    for angle, roll in zip((0.3, 1.4, 3.5), rolls, strict=True):
        place = 3 * np.array([np.cos(angle), np.sin(angle), 0.7])
        past = 1.1 * np.array([-np.sin(angle), np.cos(angle), 0.2])
        own = Rotation.from_euler("z", roll).as_matrix() @ look_at(place, past)
        poses.append(pose_files.Pose(own, place, {"fl_x": 80}))
    outlines = [framing.trace_outline(mask)] * 3
    frames = framing.frame_views(outlines, poses, DataSpec("car"))
    levels = [float(frame.rotation[0, 2]) for frame in frames]
    if max(np.abs(rolls)) == 0:
        np.testing.assert_allclose(levels, 0, atol=1e-6)
    elif max(np.abs(rolls)) < 0.2:  # up is found from all, as well as they tell it
        assert max(np.abs(levels)) < 0.11
    else:  # each stays as it was held
        assert max(np.abs(levels)) > 0.5


def test_views_without_a_usable_mask_are_left_out_and_named(tmp_path):
    said = {  # by object, of its second view
        "cut": "readable image in .*view1.png",
        "opaque": "view1.png, but it covers the whole image",
        "empty": "view1.png, but it is empty",
        "bare": "view1.png or view1_mask.png beside it",
        "size": "view1_mask.png of the size of view1.png",
    }
    for name in ("a", *said):
        write_object(tmp_path / "set" / name, views=3)
    paths = {name: tmp_path / "set" / name / "view1.png" for name in said}
    paths["cut"].write_bytes(paths["cut"].read_bytes()[:200])
    pixels = np.array(Image.open(paths["size"]))
    Image.fromarray(pixels[:40, :, 3]).save(paths["size"].with_name("view1_mask.png"))
    for name in ("size", "bare"):
        Image.fromarray(pixels[..., :3]).save(paths[name])
    for name, alpha in (("opaque", 255), ("empty", 0)):
        pixels[..., 3] = alpha
        Image.fromarray(pixels).save(paths[name])
    data = load(tmp_path)
    assert data.skipped == () and len(data.remarks) == len(said)
    assert data.counts.tolist() == [3, 2, 2, 2, 2, 2]
    for name, remark in data.remarks:
        assert re.search(said[name], remark)


def test_poses_for_some_objects_only_are_refused(tmp_path):
    place, rotations = write_set(tmp_path)[1]
    write_quaternions(place, rotations)
    with pytest.raises(ValueError, match="set/b has a pose file and .*set/a does not"):
        load(tmp_path)


def write_frame(matrix, **lens):
    frame = {"file_path": "view0", "transform_matrix": np.asarray(matrix).tolist()}
    return json.dumps(lens | {"frames": [frame]})


BAD_POSES = [
    ("poses.json", "{", "poses.json, but it cannot be used"),
    ("poses.json", "[1, 2]", "it holds a list, not names"),
    ("poses.json", '{"view0.png": [1, 0, 0]}', "four numbers that are not"),
    ("poses.json", f'{{"a": [1{"0" * 400}, 0, 0, 0]}}', "cannot be used"),
    ("transforms.json", '{"frames": [{"file_path": "view0"}]}', "transform_matrix"),
    ("transforms.json", write_frame(np.diag([2.0, 1, 1, 1])), "no rigid transform"),
    ("transforms.json", write_frame(np.diag([-1.0, 1, 1, 1])), "mirrored"),
    ("transforms.json", write_frame(np.full((4, 4), np.inf)), r"no finite .* \[4, 4\]"),
    ("transforms.json", write_frame(np.eye(4), fl_x="wide"), "fl_x is 'wide'"),
    ("transforms.json", write_frame(np.eye(4), fl_x=0), "fl_x is 0, which is imposs"),
    ("transforms.json", write_frame(np.eye(4), camera_angle_x=40), "is 40 radians"),
    ("transforms.json", write_frame(np.eye(4)), "fl_x or camera_angle_x"),
]


@pytest.mark.parametrize("name, text, message", BAD_POSES)
def test_a_pose_file_that_cannot_be_used_is_named(tmp_path, name, text, message):
    write_object(tmp_path)
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=message) as error:
        read_views(tmp_path, DataSpec("car"))
    assert str(tmp_path) in str(error.value)


def test_an_object_without_any_usable_view_is_skipped_and_the_others_stay(tmp_path):
    """Also where nothing but a damaged pose file says which images there are."""
    for i, name in enumerate("abcdef"):
        write_photos(tmp_path / "set" / name, views=3, seed=i)
    (tmp_path / "set" / "b" / "transforms.json").write_text('{"frames": [')
    place = tmp_path / "set" / "d"
    (place / "images").mkdir()
    for path in place.glob("*.png"):
        path.rename(place / "images" / path.name)
    (place / "transforms.json").write_text('{"fl_x": 3}')
    for path in (tmp_path / "set" / "f").glob("*.png"):
        path.write_bytes(b"no image")
    data = load(tmp_path)
    assert data.names == ("a", "c", "e")
    files = {"b": "transforms.json", "d": "transforms.json", "f": "view0.png"}
    assert dict(data.skipped).keys() == files.keys()
    for name, reason in data.skipped:
        assert f"{name}/{files[name]}" in reason


def test_one_or_two_objects_stand_in_all_splits_and_it_is_said(tmp_path):
    write_object(tmp_path / "set" / "only", views=4)
    for split in ("train", "val", "test"):
        data = load(tmp_path, split=split, fractions=(8, 1, 1))
        assert data.names == ("only",)
        assert "too few objects to split" in data.remarks[0][1]


def test_a_changed_mask_is_read_anew(tmp_path):
    write_set(tmp_path)
    first = load(tmp_path)
    path = tmp_path / "set" / "a" / "view0.png"
    pixels = np.array(Image.open(path))
    pixels[:30, :, 3] = 0
    Image.fromarray(pixels).save(path)
    second = load(tmp_path)
    assert (np.asarray(first.masks[0, 0]) != second.masks[0, 0]).any()


def test_photographs_are_turned_as_their_camera_noted(tmp_path):
    image, exif = Image.new("RGB", (30, 20)), Image.Exif()
    image.paste((255, 255, 255), (0, 0, 5, 20))
    exif[0x0112] = 6  # turn a quarter to the right
    image.save(tmp_path / "a.jpg", exif=exif, quality=95)
    pixels = np.asarray(read_picture(tmp_path / "a.jpg"))
    assert pixels.shape == (30, 20, 3)
    assert pixels[:5].min() > 200 and pixels[8:].max() < 50
