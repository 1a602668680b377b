"""One object without a network: `dpc_jax.fit`, its search for poses, the command."""

import dataclasses
import importlib
import json

import jax
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import dpc_jax
from dpc_jax.data.viewpoints import look_at_rotation, matrix_to_quaternion
from dpc_jax.evaluation import chamfer_distance
from dpc_jax.learning.fitting import FitSettings, descent, object_fit, pose_search
from dpc_jax.learning.fitting.cloud import Cloud
from dpc_jax.learning.fitting.pose_steps import step_poses
from dpc_jax.networks.viewpoints import list_viewpoints
from dpc_jax.render.blocks import capacity
from dpc_jax.run.object_fitting import fit_folder, list_doubts

# A few large steps; the points come from 0.45 away.
SMALL = FitSettings(num_points=300, sides=(16, 32), steps=(60, 40), learning_rate=0.03)
ONE_SIDE = FitSettings(num_points=300, sides=(32,), steps=(100,), learning_rate=0.03)
COARSE = dataclasses.replace(SMALL, sides=(16,), steps=(60,))
DIVERGING = dataclasses.replace(COARSE, steps=(3,), learning_rate=1e30)
VIEWS = 9


def make_object():
    """An L of two bars with a stub to one side: no two views of it are alike."""
    rng = np.random.default_rng(0)
    bars = [
        ((-0.3, 0.3), (-0.08, 0.08), (-0.28, -0.12)),
        ((-0.3, -0.14), (-0.08, 0.08), (-0.28, 0.3)),
        ((-0.22, -0.1), (0.08, 0.26), (-0.25, -0.1)),
    ]
    sizes = np.array([np.prod([b - a for a, b in bar]) for bar in bars])
    counts = np.round(3000 * sizes / sizes.sum()).astype(int)
    return np.concatenate(
        [
            np.stack([rng.uniform(a, b, count) for a, b in bar], axis=1)
            for bar, count in zip(bars, counts, strict=True)
        ]
    ).astype(np.float32)


def take_views(points, rotations, **more):
    return dpc_jax.project_batch(
        points, rotations, sigma=0.6, scale=6.0, grid=dpc_jax.VoxelGrid(32), **more
    )


@pytest.fixture(scope="module")
def scene():
    """Points, silhouettes [9, 32, 32] from all around, and the rotations."""
    points, elevation = make_object(), np.deg2rad(20.0)
    azimuths = 2 * np.pi * np.arange(VIEWS) / VIEWS
    cameras = [look_at_rotation(azimuth, elevation) for azimuth in azimuths]
    rotations = matrix_to_quaternion(np.stack(cameras)).astype(np.float32)
    return points, np.asarray(take_views(points, rotations).silhouette), rotations


@pytest.fixture(scope="module")
def given(scene):
    _, silhouettes, rotations = scene
    return dpc_jax.fit(silhouettes, rotations=rotations, settings=SMALL)


def measure_turns(found, true):
    """Angles between poses after the rotation of the frame that fits best; degrees."""
    found, true = (Rotation.from_quat(q, scalar_first=True) for q in (found, true))
    turns = [(found * (a.inv() * b)) * true.inv() for a, b in zip(found, true)]  # noqa: B905
    angles = [np.degrees(turn.magnitude()) for turn in turns]
    return min(angles, key=np.median)


def test_with_given_poses_the_cloud_fills_the_silhouettes_and_lies_on_the_object(
    scene, given
):
    points, _, rotations = scene
    assert given.overlaps.mean() > 0.9
    np.testing.assert_allclose(given.rotations, rotations, atol=1e-6)
    assert given.colors is given.translations is given.focal_lengths is None
    # A cell of the finer side is 0.03 wide; no silhouette tells of the inside.
    assert chamfer_distance(given.points, points).precision < 0.04
    losses = [record["loss"] for record in given.curve]
    assert losses[-1] < 0.1 * losses[0]
    assert {record["side"] for record in given.curve} == {16, 32}


def test_the_result_renders_as_it_says(given):
    image = dpc_jax.project(
        given.points,
        given.rotations[3],
        sigma=given.sigma,
        scale=given.scale,
        grid=dpc_jax.VoxelGrid(given.side),
        method="quadratic",
    ).silhouette
    np.testing.assert_allclose(image, given.silhouettes[3], atol=1e-5)


def test_large_images_are_fitted_in_blocks_by_more_points(scene, monkeypatch):
    """Though at first there is room for half of the blocks; of 32² to be quick."""
    _, silhouettes, rotations = scene
    for module in object_fit, descent:
        monkeypatch.setattr(module, "COARSE_UP_TO", 16)
    monkeypatch.setattr(descent, "_SPARE", 0.5)
    monkeypatch.setattr(capacity, "_COUNTED_FROM", 1)
    monkeypatch.setattr(capacity, "SMALL_UP_TO", 1)
    monkeypatch.setattr(capacity, "_MOST_SHARE", 1)
    found = dpc_jax.fit(silhouettes, rotations=rotations, settings=SMALL)
    assert found.side == 32 and found.points.shape == (1200, 3)
    assert found.overlaps.mean() > 0.85


def turn_at_random(rotations, degrees, seed=1):
    """By a normal angle about each axis of the camera."""
    turns = np.random.default_rng(seed).normal(size=(len(rotations), 3))
    turned = Rotation.from_rotvec(np.deg2rad(degrees) * turns)
    turned *= Rotation.from_quat(rotations, scalar_first=True)
    return turned.as_quat(scalar_first=True).astype(np.float32)


@pytest.fixture
def quick_search(monkeypatch):
    level = pose_search.Level(32, 300, 20, (10,))
    monkeypatch.setattr(pose_search, "FINER", (level,))
    for name, rounds in ("NEAR", 40), ("FROM_NOTHING", 30):
        changes = {"rounds": rounds, "viewpoints": (24, 3)}
        levels = [one._replace(**changes) for one in getattr(pose_search, name)]
        monkeypatch.setattr(pose_search, name, levels)


def test_rough_poses_become_right_and_stay_so_while_the_cloud_is_fitted(
    scene, quick_search
):
    _, silhouettes, rotations = scene
    rough = turn_at_random(rotations, 10)
    fitted = dpc_jax.fit(
        silhouettes,
        rotations=rough,
        learn=("rotations",),
        settings=dataclasses.replace(SMALL, searches=1),
    )
    assert np.median(measure_turns(rough, rotations)) > 10
    # By a pixel at its ends the L turns by 5 degrees.
    turns = measure_turns(fitted.rotations, rotations)
    assert np.median(turns) < 3 and np.max(turns) < 10
    np.testing.assert_allclose(np.linalg.norm(fitted.rotations, axis=1), 1, atol=1e-5)
    assert fitted.overlaps.mean() > 0.88


def test_steps_of_poses_find_those_of_a_known_cloud_and_their_translations(scene):
    points, _, rotations = scene
    # The mass of `take_views`, in the units of a cloud.
    log_mass = np.float32(np.log(6 * len(points) / 2000))
    cloud = Cloud(points, log_mass, None, rotations, None, None)
    moves = np.random.default_rng(2).normal(size=(VIEWS, 3)) * [0.03, 0.03, 0]
    moves = (moves - moves.mean(axis=0)).astype(np.float32)
    images = take_views(points, rotations, translations=moves, method="quadratic")
    rough = turn_at_random(rotations, 3)
    found = cloud._replace(rotations=rough, translations=np.zeros_like(moves))
    step, losses = jax.jit(step_poses), []
    how = {"sigma": 0.6, "camera": dpc_jax.Camera()}
    for _ in range(8):
        found, loss = step(found, images.silhouette, **how)
        losses.append(loss)
    # No step makes a view worse; the images are rounded.
    assert (np.diff(losses, axis=0) < 1e-6).all()
    turns = Rotation.from_quat(found.rotations, scalar_first=True)
    turns *= Rotation.from_quat(rotations, scalar_first=True).inv()
    # A fifth of a pixel at the ends; distances hardly show, and turns make up for them.
    assert np.degrees(turns.magnitude()).max() < 1
    np.testing.assert_allclose(found.translations[:, :2], moves[:, :2], atol=0.003)


def test_a_cloud_and_its_poses_are_improved_together(scene):
    points, silhouettes, rotations = scene
    rough, mass = turn_at_random(rotations, 6), np.log(6 * len(points) / 2000)
    begun = Cloud(points, mass, None, rough, np.zeros((VIEWS, 3)), None)
    level = pose_search.Level(32, 600, 30, compared=())
    inputs = begun, silhouettes, rough, jax.random.key(0), level, dpc_jax.Camera()
    found, _ = pose_search.improve(*inputs)
    assert np.median(measure_turns(rough, rotations)) > 6
    # By a pixel at its ends the L turns by 5 degrees.
    assert np.median(measure_turns(found.rotations, rotations)) < 3
    np.testing.assert_allclose(np.linalg.norm(found.rotations, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(found.translations.mean(axis=0), 0, atol=1e-6)


def test_views_from_one_side_make_candidates_of_the_other_likelier():
    around = list_viewpoints((-10.0, 30.0), azimuths=8, rings=2)
    shares = np.zeros((3, 8 * 2))
    shares[:, 5] = 1
    crowding = np.asarray(pose_search.measure_crowding(around, shares))
    turns = Rotation.from_quat(around, scalar_first=True).as_matrix()
    azimuths = np.arctan2(turns[:, 2, 1], turns[:, 2, 0])
    np.testing.assert_allclose(crowding, np.cos(azimuths - azimuths[5]), atol=1e-5)
    evenly = pose_search.measure_crowding(around, np.full((3, 16), 1 / 16))
    np.testing.assert_allclose(evenly, 0, atol=1e-6)


def test_translations_colors_and_depths_are_fitted_where_they_are_asked_for(scene):
    """Translations with their mean held."""
    points, _, rotations = scene
    moves = np.zeros((VIEWS, 3), np.float32)
    moves[::2, 0], moves[1::2, 0] = 0.06, -0.06
    images = take_views(
        points,
        rotations,
        translations=moves,
        colors=np.broadcast_to(np.float32([0.8, 0.1, 0.1]), points.shape),
        signals=("silhouette", "color", "depth"),
    )
    silhouettes = np.asarray(images.silhouette)
    fitted = dpc_jax.fit(
        silhouettes,
        rotations=rotations,
        learn=("translations",),
        colors=np.clip(images.color, 0, 1),
        depths=np.where(silhouettes > 0.5, images.depth, 0),
        settings=ONE_SIDE,
    )
    assert fitted.translations is not None and fitted.colors is not None
    assert np.abs(fitted.translations[:, 0] - moves[:, 0]).mean() < 0.03
    assert np.abs(fitted.translations.mean(axis=0)).max() < 0.03
    assert np.median(fitted.colors, axis=0) == pytest.approx([0.8, 0.1, 0.1], abs=0.15)
    assert fitted.overlaps.mean() > 0.85


def test_a_search_from_nothing_finds_most_poses(scene, quick_search):
    """Of random rotations one in a thousand is within 15° of the right one."""
    _, silhouettes, rotations = scene
    found = pose_search.search_poses(
        {"masks": np.round(255 * silhouettes).astype(np.uint8)},
        jax.random.key(0),
        settings=FitSettings(searches=1),
        camera=dpc_jax.Camera(),
        tell=lambda *_: None,
    )
    assert np.mean(measure_turns(found.rotations, rotations) < 15) >= 0.6


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"silhouettes": np.ones((3, 32, 16))}, "silhouettes must be square images"),
        ({"silhouettes": np.zeros((3, 32, 32))}, "no pixel of view 0"),
        ({"silhouettes": np.full((3, 32, 32), 7.0)}, "reach from 7 to 7"),
        ({"silhouettes": np.ones((3, 24, 24))}, "it is 24; bring the images to 32 or"),
        ({"rotations": np.ones((2, 4))}, "rotations must have shape"),
        ({"learn": ("roll",)}, "learn must be"),
        ({"depths": np.full((3, 32, 32), np.nan)}, "depths must be finite"),
        ({"colors": np.ones((3, 32, 32))}, "colors must be RGB images"),
        ({"settings": FitSettings(steps=(3,))}, "settings.steps must have a number"),
        (
            {"settings": DIVERGING, "rotations": np.eye(4)[[0, 0, 0]]},
            "a fit that converges, .* than 1e\\+30",
        ),
    ],
)
def test_what_cannot_be_fitted_is_said_in_a_sentence(changes, words):
    """By the function, though the command is loaded, which has its name."""
    importlib.import_module("dpc_jax.fit")
    arguments = {"silhouettes": np.ones((3, 32, 32)), "settings": SMALL} | changes
    with pytest.raises(ValueError, match=words):
        dpc_jax.fit(arguments.pop("silhouettes"), **arguments)


@pytest.mark.parametrize("crop", ["none", "object"])
def test_a_folder_of_images_becomes_files(scene, tmp_path, capsys, crop):
    """Images with alpha, one more of them empty, and their poses."""
    _, silhouettes, rotations = scene
    place, poses = tmp_path / "images", {}
    place.mkdir()
    for i in range(VIEWS + 1):
        view = i % VIEWS
        alpha = np.round(255 * silhouettes[view] * (i < VIEWS)).astype(np.uint8)
        colors = np.full((32, 32, 3), 90, np.uint8)
        Image.fromarray(np.dstack([colors, alpha])).save(place / f"{i}.png")
        poses[f"{i}.png"] = rotations[view].tolist()
    (place / "poses.json").write_text(json.dumps(poses))
    out = tmp_path / "out"
    fit_folder(place, out, image_size=32, crop=crop, settings=COARSE)
    facts = json.loads((out / "fit.json").read_text())
    assert set(facts["views"]) == {f"{i}.png" for i in range(VIEWS)}
    assert facts["overlap"] > 0.85 and facts["points"] == 300
    # Images cut out by their masks do not have the object's middle in theirs.
    moved = [view.get("translation") for view in facts["views"].values()]
    assert moved == [None] * VIEWS if crop == "none" else np.shape(moved) == (VIEWS, 3)
    assert facts["views"]["3.png"]["azimuth_deg"] == pytest.approx(120, abs=1)
    for name in ("cloud.ply", "cloud.glb", "views.png", "curve.png"):
        assert (out / name).stat().st_size > 0
    shown = capsys.readouterr()
    assert "9.png" in shown.err and "is empty" in shown.err
    assert "Fitting: fitting at 16" in shown.out and "Overlap" in shown.out


def test_few_views_without_poses_and_views_not_explained_are_doubted():
    good = {f"{i}.png": 0.94 for i in range(6)}
    assert list_doubts(good, is_searched=False) == []
    (few,) = list_doubts(good, is_searched=True)
    assert "6 views are few to find poses by" in few
    many = {f"{i}.png": 0.94 for i in range(20)}
    assert list_doubts(many, is_searched=True) == []
    (poor,) = list_doubts(many | {"7.png": 0.5}, is_searched=True)
    assert "1 of 20 views well: 7.png" in poor
