"""Predicted viewpoints are moved to where the image fits better, and no further."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import make_dataset, make_network, make_state, tiny_config

from dpc_jax import rotation_angle_deg
from dpc_jax.config import replace_fields
from dpc_jax.learning.inference import viewpoint_search
from dpc_jax.learning.inference.explanation import compare_poses
from dpc_jax.learning.inference.predictor import make_predictor, predict_all
from dpc_jax.learning.inference.refinement import Evidence, rank_poses
from dpc_jax.learning.inference.viewpoint_search import STEPS, search_nearby
from dpc_jax.learning.shapes.kind import View
from dpc_jax.learning.shapes.points import Points
from dpc_jax.networks.viewpoints import face_object, read_elevations
from dpc_jax.render import Camera

CONFIG = tiny_config(student="posterior", flips=True, head="viewpoint", fine_grid=32)
RATIO = CONFIG.render.finest / CONFIG.render.grid


def face(azimuth, elevation):
    """The pose [4] of a viewpoint in degrees."""
    return face_object(jnp.deg2rad(azimuth), jnp.deg2rad(elevation))


def make_scene():
    """A lopsided cloud: no two viewpoints show the same."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.4, 0.4, (60, 3)) * [1.0, 0.6, 0.4]
    points[:20, 0] += 0.1
    points = jnp.asarray(points, jnp.float32)
    return {"points": points, "mass": jnp.array(3.0), "sigma": 0.3}


@jax.jit
def see(pose):
    """The silhouette of the scene in the finest grid."""
    camera = Camera(CONFIG.render.focal_length, CONFIG.render.distance)
    view = View(pose, camera, CONFIG.render.finest)
    scene = Points.resize(make_scene(), RATIO)
    return Points.render(scene, view, signals=("silhouette",)).silhouette


@jax.jit
def search(pose, target):
    return search_nearby(make_scene(), pose, target, {}, config=CONFIG)


@jax.jit
def measure(pose, target):
    finer = Points.resize(make_scene(), RATIO)
    return compare_poses(finer, pose[None], target, {}, config=CONFIG)[0]


@pytest.mark.parametrize("azimuth", [-170.0, -35.0, 0.0, 80.0, 179.0])
def test_an_elevation_is_read_from_the_pose_of_any_azimuth(azimuth):
    for elevation in (-80.0, -20.0, 0.0, 40.0, 85.0):
        read = read_elevations(3 * face(azimuth, elevation))  # of any length
        # The slope of arcsin is 1/cos 85° = 11 at the steepest, times float32's 1e-7.
        assert np.rad2deg(read) == pytest.approx(elevation, abs=1e-3)


def test_neighbours_are_a_step_of_azimuth_or_elevation_away():
    found = viewpoint_search._list_neighbours(face(50.0, 10.0), jnp.deg2rad(4.0))
    expected = [face(54.0, 10.0), face(46.0, 10.0), face(50.0, 14.0), face(50.0, 6.0)]
    angles = [
        [float(rotation_angle_deg(pose, other)) for other in expected] for pose in found
    ]
    # Each is one of them; in which order does not matter.
    assert (np.min(angles, axis=0) < 0.1).all() and (np.min(angles, axis=1) < 0.1).all()


@pytest.mark.parametrize("start", [(53.0, 12.0), (46.0, 14.0), (50.0, 2.0)])
def test_a_viewpoint_some_degrees_off_comes_nearer_to_the_truth(start):
    truth = face(50.0, 10.0)
    target, pose = see(truth), face(*start)
    found = search(pose, target)
    before, after = (float(rotation_angle_deg(q, truth)) for q in (pose, found))
    # The last step leaves at most half of it on either axis, 1.4° in all, where the
    # loss falls towards the truth; these starts are 3.6 to 8 degrees off.
    assert after < 0.5 * before and after < 2.5
    assert float(measure(found, target)) < float(measure(pose, target))


def test_the_right_viewpoint_stays_as_it_is():
    truth = face(-120.0, 25.0)
    assert np.array_equal(search(truth, see(truth)), truth)


def test_points_weigh_as_much_together_as_those_that_training_renders_last():
    """Twice each point, and half of them kept: the outlines of the scene itself."""
    target, start = see(face(-120.0, 25.0)), face(-116.0, 19.0)
    scene = make_scene()
    twice = {**scene, "points": jnp.tile(scene["points"], (2, 1))}
    half = replace_fields(CONFIG, {"render": {"keep_end": 0.5}})
    found = search_nearby(twice, start, target, {}, config=half)
    np.testing.assert_allclose(found, search(start, target), atol=1e-6)
    of_all = search_nearby(twice, start, target, {}, config=CONFIG)
    assert np.abs(of_all - found).max() > 1e-3  # outlines that are wider find another


def test_elevations_stay_in_the_range_of_the_heads():
    high = CONFIG.pose.elevation_high
    found = search(face(50.0, high), see(face(50.0, high + 8.0)))
    assert np.rad2deg(read_elevations(found)) <= high + 0.1
    free = replace_fields(CONFIG, {"pose": {"elevation_high": high + 30.0}})
    wider = search_nearby(
        make_scene(), face(50.0, high), see(face(50.0, high + 8.0)), {}, config=free
    )
    assert np.rad2deg(read_elevations(wider)) > high + 3


@pytest.mark.usefixtures("quickly")
@pytest.mark.parametrize("head", ["viewpoint", "quaternion"])
def test_predictions_are_moved_where_heads_say_viewpoints_alone(head):
    changes = {"pose": {"head": head}, "render": {"fine_grid": 16}}
    config = replace_fields(CONFIG, changes)
    network = make_network(config)
    predictor = make_predictor(network, config, keeps_candidates=True)
    dataset = make_dataset(models=3, views=2)
    found = predict_all(predictor, make_state(network, config), dataset)
    angles = rotation_angle_deg(found.poses[:, :, None], found.candidates)
    away = np.asarray(angles).min(axis=-1)
    if head == "quaternion":
        assert (away < 0.1).all()
    else:
        assert (away > 1).any() and (away <= np.hypot(sum(STEPS), sum(STEPS))).all()


@pytest.mark.usefixtures("quickly")
def test_views_of_one_object_are_searched_for_where_one_pose_is_asked_for():
    truth, rival = face(50.0, 10.0), face(200.0, 0.0)
    candidates = jnp.stack([rival, face(47.0, 12.0), face(130.0, 5.0)])
    scene = make_scene()
    shared = {"mass": scene["mass"], "sigma": jnp.array(scene["sigma"])}
    masks = jnp.rint(255 * see(truth)).astype(jnp.uint8)[None, None]
    evidence = Evidence(
        codes=None,
        poses=candidates[None, None, 0],
        candidates=candidates[None, None],
        probabilities=jnp.full((1, 1, 3), 1 / 3),
        masks=masks,
        weights=jnp.ones((1, 1)),
        own={},
    )

    @functools.partial(jax.jit, static_argnames=("count", "config"))
    def rank(count, config=CONFIG):
        points = {"points": scene["points"][None]}
        return rank_poses(points, shared, evidence, config, count=count)[0, 0]

    (one,), several = rank(1), rank(3)
    assert np.array_equal(several[0], candidates[1])  # as they are
    assert rotation_angle_deg(one, truth) < rotation_angle_deg(candidates[1], truth) / 2
    student = replace_fields(CONFIG, {"pose": {"student": "selects"}})
    assert np.array_equal(rank(1, student)[0], candidates[1])
