"""What `predict` reads: masks, folders, moving pictures, and files of no use."""

import dataclasses
import sys

import av
import numpy as np
import pytest
from data_trees import write_photos
from PIL import Image
from scipy.spatial.transform import Rotation

from dpc_jax.data import DataSpec
from dpc_jax.data.sets import masks, pictures
from dpc_jax.data.sets.image_folder import read_views
from dpc_jax.data.sets.photographs import MOST_FRAMES, read_photographs
from dpc_jax.data.sets.pose_files import read_poses
from dpc_jax.data.viewpoints import look_at_rotation
from dpc_jax.data.views import build_scene, draw_lights, render_view
from dpc_jax.evaluation.rotations import rotation_angle_deg, to_quaternion, to_rotation
from dpc_jax.run.prediction.still_objects import agree_on_pose, turn_to_cameras
from dpc_jax.shapes.procedural import make_shape

SPEC = DataSpec("car", kind="images", folder=".", image_size=16, crop="object")


def draw_disc(*, radius=9, alpha=True):
    rows, cols = np.mgrid[:40, :40]
    mask = (rows - 20) ** 2 + (cols - 17) ** 2 < radius**2
    image = np.full((40, 40, 3), (230, 225, 215), np.uint8)
    image[mask] = (60, 90, 160)
    if not alpha:
        return Image.fromarray(image)
    return Image.fromarray(np.dstack([image, np.uint8(255 * mask)]))


def read(*paths, mask="given", is_one_object=False, spec=SPEC):
    return read_photographs(paths, spec, mask=mask, is_one_object=is_one_object)


def measure_overlap(found, true):
    return (found & true).sum() / (found | true).sum()


def take_photograph(category, background, *, side):
    """An image of an object before a backdrop, and its true mask."""
    rng = np.random.default_rng(0)
    view = render_view(
        build_scene(make_shape(category, 1)),
        look_at_rotation(rng.uniform(0, 2 * np.pi), 0.3),
        lights=draw_lights(rng),
        image_size=side,
    )
    share = view.mask[..., None] / 255.0
    # On white: what the white adds at the edge is taken away again.
    colors = view.image.astype(np.float64) - 255.0 * (1.0 - share)
    backdrop = np.full((side, side, 3), (90.0, 160.0, 210.0))
    v, u = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j]
    if background == "gradient":
        backdrop = backdrop * (1 + 0.25 * u - 0.1 * (u**2 + v**2))[..., None]
    if background == "shadow":
        low = v[np.nonzero(view.mask > 127)[0].max(), 0]
        depth = (2 * u) ** 2 + ((v - low) / 0.1) ** 2
        backdrop = backdrop * (1 - 0.25 * np.exp(-depth))[..., None]
    image = colors + backdrop * (1.0 - share)
    if background == "noisy":
        image = image + rng.normal(0, 10, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), view.mask > 127


@pytest.mark.parametrize(
    ("category", "background"),
    [("car", "noisy"), ("car", "shadow"), ("chair", "gradient")],
)
def test_masks_are_found_on_plain_backgrounds(background, category):
    """Noise, uneven light and a shadow cost little."""
    image, true = take_photograph(category, background, side=256)
    found = masks.find_before_plain_background(image)
    assert found.shape == true.shape and found.dtype == np.float32
    assert measure_overlap(found > 0.5, true) > 0.85


def test_a_hole_that_shows_the_background_stays_open():
    image = np.full((96, 96, 3), 200, np.uint8)
    image[20:76, 20:76] = (150, 30, 30)
    image[36:60, 36:60] = 200  # seen through it
    mask = masks.find_before_plain_background(image) > 0.5
    assert mask[28, 48] and not mask[48, 48] and not mask[5, 5]


def test_auto_prefers_a_mask_that_is_given(tmp_path):
    draw_disc().save(tmp_path / "given.png")
    draw_disc(alpha=False).save(tmp_path / "bare.jpg", quality=95)
    objects, skipped = read(*sorted(tmp_path.iterdir()), mask="auto")
    assert [one.name for one in objects] == ["bare", "given"] and not skipped
    bare, given = (one.masks[0] > 127 for one in objects)
    assert measure_overlap(bare, given) > 0.9
    objects, skipped = read(*sorted(tmp_path.iterdir()))
    assert [one.name for one in objects] == ["given"]
    assert "neither" in skipped[0][1] and "bare.jpg" in skipped[0][0]


def test_a_folder_holds_the_views_of_one_object(tmp_path):
    for name in ("sofa", "stool"):
        (tmp_path / name).mkdir()
        for radius in (6, 12):
            draw_disc(radius=radius).save(tmp_path / name / f"{radius:02}.png")
    objects, _ = read(tmp_path)
    assert [(one.name, len(one.images)) for one in objects] == [
        ("sofa", 2),
        ("stool", 2),
    ]
    # Views of an object share a scale: a disc of half the radius covers a quarter.
    small, large = (mask.sum(dtype=float) for mask in objects[0].masks)
    assert 0.2 < small / large < 0.3
    (one,), _ = read(tmp_path, is_one_object=True)
    assert one.name == "object" and len(one.images) == 4


def test_the_part_kept_of_a_large_photograph_shows_what_the_whole_does(tmp_path):
    rows, columns = np.mgrid[:1500, :2900]
    layers = rows // 8, columns // 16, 0 * rows, 0 * rows
    pixels = np.stack(layers, -1).astype(np.uint8)
    is_object = ((rows - 740) / 600) ** 2 + ((columns - 1500) / 1350) ** 2 < 1
    pixels[is_object, 3] = 255  # 2699 pixels wide: each third one is kept
    Image.fromarray(pixels).save(tmp_path / "a.png", compress_level=1)
    spec = dataclasses.replace(SPEC, image_size=128)
    ((found,), _) = read(tmp_path / "a.png", spec=spec)
    _, arrays, _ = read_views(tmp_path / "a.png", spec)
    # Samples lie up to a tenth of a pixel apart. One third of 25 off has 53 and 0.4.
    for name, kept in (("images", found.images), ("masks", found.masks)):
        away = np.abs(1.0 * arrays[name] - kept)
        assert away.max() < 25 and away.mean() < 0.1


def test_views_of_known_cameras_are_those_that_training_would_see(tmp_path):
    """With place and lens known, though the images have another centre and size."""
    place = tmp_path / "mug"
    write_photos(place, views=4)
    (one,), skipped = read(place)
    files, arrays, _ = read_views(place, SPEC)
    assert not skipped and one.name == "mug" and one.files == tuple(files)
    np.testing.assert_array_equal(one.images, arrays["images"])
    np.testing.assert_array_equal(one.masks, arrays["masks"])
    # A pose in the view that was cut out is told as one in the camera that took it.
    cameras = read_poses([place / "transforms.json"])
    own = [cameras[file].rotation for file in files]
    poses = turn_to_cameras(arrays["quaternions"], one.cameras, one.turns)
    found = to_rotation(poses).as_matrix()
    np.testing.assert_allclose(found, own, atol=1e-6)  # float32
    plain = dataclasses.replace(SPEC, crop="none")  # framed as in training: as they are
    (as_they_are,), _ = read(place, spec=plain)
    assert as_they_are.cameras is None
    assert np.abs(1.0 * as_they_are.masks - one.masks).max() > 100
    draw_disc().save(place / "new.png")  # which has no camera, and is not asked for
    assert len(read(place)[0][0].images) == 4
    write_photos(tmp_path / "pan", views=3, convention="opencv")  # which they are not
    objects, skipped = read(tmp_path)
    assert [one.name for one in objects] == ["mug"]
    assert skipped[0][0] == str(tmp_path / "pan")
    assert "check the convention of the poses" in skipped[0][1]


def test_views_of_known_cameras_agree_on_one_pose_of_the_object():
    """Two of four views are taken for their half turns, with less confidence."""
    random, views = np.random.default_rng(0), 4
    cameras, true = (Rotation.random(n, rng=random) for n in (views, 1))
    off = Rotation.from_rotvec(0.05 * random.normal(size=(views, 3)))
    near = cameras * true * off
    turned = near * Rotation.from_euler("z", 180, degrees=True)
    candidates = np.stack([to_quaternion(near), to_quaternion(turned)], axis=1)
    chances = np.array([[0.4, 0.6], [0.4, 0.6], [0.9, 0.1], [0.9, 0.1]])
    poses = candidates[np.arange(views), chances.argmax(axis=1)]
    found = agree_on_pose(cameras.as_matrix(), poses, candidates, chances)
    right = to_quaternion(cameras * (true * off[2:].mean()))
    assert rotation_angle_deg(found, right).max() < 1e-4
    # What views think likely counts where no view was taken for it.
    poses = to_quaternion(Rotation.random(views, rng=random))
    found = agree_on_pose(cameras.as_matrix(), poses, candidates, chances)
    assert rotation_angle_deg(found, to_quaternion(near)).max() < 20


@pytest.mark.parametrize("kind", ["gif", "webp", "png"])
def test_the_frames_of_a_moving_picture_are_views_of_one_object(tmp_path, kind):
    count = 2 * MOST_FRAMES
    frames = [draw_disc(radius=6 + i // 6, alpha=False) for i in range(count)]
    path = tmp_path / f"turn.{kind}"
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=50)
    (one,), skipped = read(path, mask="auto")
    assert not skipped and one.name == "turn"
    # Frames of the same content may be stored once.
    assert 5 <= len(one.images) <= MOST_FRAMES
    assert one.sources[1].startswith(f"{path}, frame ")


def write_video(path, frames):
    """An uncompressed kind, so that frames come back as they were."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=10)
        stream.width, stream.height = frames[0].size
        stream.pix_fmt = "bgr0"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_image(frame)))
        container.mux(stream.encode())


def test_frames_of_a_video_are_taken_in_equal_steps_from_its_first_on(tmp_path):
    path = tmp_path / "turn.mkv"
    for count in (3, MOST_FRAMES, 7 * MOST_FRAMES):
        write_video(path, [Image.new("RGB", (32, 16), (i, 0, 0)) for i in range(count)])
        frames = pictures.read_frames(path, MOST_FRAMES)
        numbers = [frame.getpixel((0, 0))[0] for frame in frames]
        assert frames[0].size == (32, 16)
        assert len(numbers) == min(count, MOST_FRAMES) and numbers[0] == 0
        steps = np.diff([*numbers, count])
        assert max(steps) - min(steps) <= 4  # what is kept has steps of up to four


def test_a_video_is_one_object_and_one_of_no_use_is_named(tmp_path, monkeypatch):
    path = tmp_path / "turn.mp4"  # not by its name: Matroska is told by content
    write_video(tmp_path / "turn.mkv", [draw_disc(alpha=False)] * 5)
    (tmp_path / "turn.mkv").rename(path)
    (one,), skipped = read(path, mask="auto")
    assert not skipped and one.name == "turn" and len(one.images) == 5
    assert one.sources[1] == f"{path}, frame 2"
    path.write_text("no video")
    with pytest.raises(ValueError, match=f"readable video in {path}, but it is"):
        read(path, mask="auto")
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ValueError, match=r"PyAV .* install .*dpc_jax\[video\]"):
        read(path, mask="auto")


def test_what_cannot_be_read_is_named_with_a_reason(tmp_path):
    good, bad = tmp_path / "good.png", tmp_path / "bad.png"
    draw_disc().save(good)
    bad.write_text("no image")
    objects, skipped = read(good, bad, tmp_path / "none.png")
    assert [one.name for one in objects] == ["good"]
    reasons = dict(skipped)
    assert "damaged or of another kind" in reasons[str(bad)]
    assert "is not there" in reasons[str(tmp_path / "none.png")]
    with pytest.raises(ValueError, match=f"readable image in {bad}, but"):
        read(bad)
    with pytest.raises(ValueError, match="Expected images .* in the folder"):
        (tmp_path / "empty").mkdir()
        read(tmp_path / "empty")
