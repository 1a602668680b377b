"""Predicted poses: the student's, or what the silhouette speaks for, moved nearby."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import make_dataset, make_network, make_state, tiny_config

from dpc_jax import rotation_angle_deg
from dpc_jax.config import replace_fields
from dpc_jax.learning import framing
from dpc_jax.learning.inference import predictor
from dpc_jax.learning.inference import search as search_module
from dpc_jax.learning.inference.explanation import (
    Observation,
    compare_poses,
    find_posteriors,
    observe,
    render_finest,
)
from dpc_jax.learning.inference.predictor import make_predictor, predict_all
from dpc_jax.learning.inference.search import (
    FINALISTS,
    add_viewpoints,
    find_likeliest,
    search_nearby,
)
from dpc_jax.learning.shapes.points import Points
from dpc_jax.networks.viewpoints import face_object, read_elevations

CONFIG = tiny_config(
    student="selects", flips=True, head="viewpoint", fine_grid=32, keep_end=1.0
)
UNSEARCHED = replace_fields(CONFIG, {"pose": {"head": "quaternion"}})


def face(azimuth, elevation):
    """The pose [4] of a viewpoint in degrees."""
    return face_object(jnp.deg2rad(azimuth), jnp.deg2rad(elevation))


TRUTH, RIVAL = face(50.0, 10.0), face(200.0, 0.0)


def make_scene():
    """A lopsided cloud: no two viewpoints show the same."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.4, 0.4, (60, 3)) * [1.0, 0.6, 0.4]
    points[:20, 0] += 0.1
    points = jnp.asarray(points, jnp.float32)
    return {"points": points, "mass": jnp.array(3.0), "sigma": 0.3}


@jax.jit
def see(pose):
    """What the scene shows in the finest grid."""
    return Observation(
        render_finest(make_scene(), pose, {}, config=CONFIG).silhouette, {}
    )


@functools.partial(jax.jit, static_argnames="config")
def search(pose, observation, mass=3.0, *, config=CONFIG):
    """The viewpoint found near a pose, and its loss."""
    scene = Points.weigh_finest(make_scene() | {"mass": mass}, config.render)
    return search_nearby(scene, pose, observation, config=config)


@jax.jit
def measure(poses, observation):
    """Losses in the finest grid."""
    scene = Points.weigh_finest(make_scene(), CONFIG.render)
    return compare_poses(scene, poses, observation, config=CONFIG)


@functools.partial(jax.jit, static_argnames=("count", "config"))
def take_likeliest(
    candidates, losses, observation, chances=None, *, count, config=UNSEARCHED
):
    """Of the scene; without chances of candidates where the student thinks nothing."""
    alike = jnp.full(len(candidates), 1 / len(candidates))
    known = candidates, losses, alike if chances is None else chances, observation
    return find_likeliest(make_scene(), *known, count=count, config=config)


def test_a_posterior_is_finite_where_the_student_thinks_nothing_of_a_candidate():
    found = find_posteriors(jnp.array([1e4, 1e4]), jnp.zeros(2))
    assert np.isfinite(found).all()


def test_the_likeliest_few_are_compared_in_the_finest_grid():
    """In the order of their losses there, whatever the base grid says of them."""
    poses = [face(30.0, 5.0), RIVAL, face(52.0, 12.0), face(80.0, 0.0), TRUTH]
    candidates, observation = jnp.stack(poses), see(TRUTH)
    losses = jnp.array([2.2, 2.0, 2.5, 8.0, 9.0])  # the truth is left out
    few = jnp.array([0, 1, 2])
    found = take_likeliest(candidates, losses, observation, count=FINALISTS)
    order = jnp.argsort(measure(candidates[few], observation))
    assert np.array_equal(found, candidates[few][order])
    assert np.array_equal(found[0], candidates[2])


def test_neighbours_of_a_likelier_pose_are_not_compared():
    near = [face(100.0 + shift, 5.0) for shift in range(0, 15, 3)]
    candidates, observation = jnp.stack([*near, RIVAL, TRUTH]), see(TRUTH)
    losses = jnp.array([1.0, 1.1, 1.2, 1.3, 1.4, 5.0, 6.0])
    (found,) = take_likeliest(candidates, losses, observation, count=1)
    assert np.array_equal(found, TRUTH)


def test_what_the_student_thinks_counts_in_the_finest_grid(monkeypatch):
    candidates = jnp.stack([face(40.0 * i, 0.0) for i in range(5)])
    fine = jnp.array([5.0, 4.6, 5.0, 0.0, 0.0])

    def compare(scene, poses, *_, **__):
        return fine[jnp.argmax(jnp.abs(poses @ candidates.T), axis=1)]

    monkeypatch.setattr(search_module, "compare_poses", compare)
    chances = jnp.array([0.5, 0.3, 0.1, 0.06, 0.04])

    def take(losses):
        known = candidates, jnp.array(losses), chances, Observation(None, {})
        (found,) = find_likeliest(make_scene(), *known, count=1, config=UNSEARCHED)
        return np.flatnonzero(np.all(candidates == found[None], axis=1))

    assert take([9.0, 9, 9, 99, 99]) == [0]
    assert take([9.0, 9, 99, 9, 99]) == [3]


def test_viewpoints_are_searched_for_nearby_before_they_are_compared():
    """The truth's neighbour, 16° off, is less likely than the rival as it is."""
    candidates = jnp.stack([face(62.0, -1.0), face(220.0, 10.0)])
    near, rival = measure(candidates, see(TRUTH))
    chances = jnp.array([jnp.exp(near - rival - 5), 1.0])
    known = candidates, jnp.zeros(2), see(TRUTH), chances
    assert np.array_equal(take_likeliest(*known, count=1)[0], candidates[1])
    found = take_likeliest(*known, count=2, config=CONFIG)
    assert len(found) == 2 and rotation_angle_deg(found[0], TRUTH) < 2


@pytest.mark.parametrize("knows_distance", [True, False])
def test_a_viewpoint_that_no_head_offers_is_found(knows_distance):
    candidates = jnp.stack([RIVAL, face(-100.0, 0.0)])

    @jax.jit
    def look(masks):
        how = {"config": CONFIG, "knows_distance": knows_distance}
        base, fine = (observe(masks, {}, side, **how) for side in (16, 32))
        known, scene = (candidates, jnp.full(2, 0.5), base), make_scene()
        poses, chances = add_viewpoints(scene, *known, config=CONFIG)
        losses = compare_poses(scene, poses, base, config=CONFIG)
        known = scene, poses, losses, chances, fine
        return poses, chances, find_likeliest(*known, count=1, config=CONFIG)

    poses, chances, found = look(np.uint8(255 * np.asarray(see(TRUTH).target)))
    assert np.array_equal(poses[:2], candidates) and len(poses) == 2 + FINALISTS
    assert chances.sum() == pytest.approx(1) and (chances[2:] < 0.03 * chances[0]).all()
    angles = np.rad2deg(read_elevations(poses[2:]))
    assert (angles > CONFIG.pose.elevation_low).all()
    assert (angles < CONFIG.pose.elevation_high).all()
    assert rotation_angle_deg(found[0], TRUTH) < 3


def test_an_elevation_is_read_from_the_pose_of_any_azimuth():
    azimuths, elevations = np.meshgrid([-170.0, -35, 0, 80, 179], [-80.0, -20, 0, 85])
    read = read_elevations(3 * face(azimuths.ravel(), elevations.ravel()))  # any length
    # The slope of arcsin is 1/cos 85° = 11 at the steepest, times float32's 1e-7.
    np.testing.assert_allclose(np.rad2deg(read), elevations.ravel(), atol=1e-3)


@pytest.mark.parametrize("middle", [(0.0, 0.0), (0.05, -0.1)])
def test_a_pose_is_told_from_others_whatever_the_distance(middle):
    """The true pose fits, where a camera of the run's distance would choose wrong."""
    place = framing.Frame(jnp.array(middle), jnp.array(1.5))  # farther
    seen = framing.cut_silhouettes(see(TRUTH).target, place)
    masks = np.uint8(255 * np.asarray(seen))
    poses = jnp.stack([TRUTH, face(20.0, 6.0), face(90.0, 6.0), RIVAL])

    def compare(knows_distance):
        how = {"config": CONFIG, "knows_distance": knows_distance}
        return measure(poses, observe(masks, {}, 32, **how))

    costs = compare(False)
    assert costs.argmin() == 0 and costs[0] < 0.25 * costs[1:].min()
    assert compare(True)[0] > 5 * costs[0]


@pytest.mark.parametrize("start", [(53.0, 12.0), (46.0, 14.0), (50.0, 2.0)])
def test_a_viewpoint_some_degrees_off_comes_nearer_to_the_truth(start):
    observation, pose = see(TRUTH), face(*start)
    found, _ = search(pose, observation)
    before, after = (float(rotation_angle_deg(q, TRUTH)) for q in (pose, found))
    # These starts are 3.6 to 8 degrees off. Costs are no parabolas: 0.6° are left at
    # most, where steps of 2° and more would leave 1°.
    assert after < 0.2 * before and after < 0.8
    worse, better = measure(jnp.stack([pose, found]), observation)
    assert better < worse
    assert np.array_equal(search(TRUTH, observation)[0], TRUTH)


def test_a_shape_that_shows_nothing_leaves_the_viewpoint_as_it_is():
    found, loss = search(RIVAL, see(TRUTH), 0.0)
    assert np.array_equal(found, RIVAL)
    assert loss == pytest.approx(jnp.sum(see(TRUTH).target ** 2))


def test_elevations_stay_in_the_range_of_the_heads():
    high = CONFIG.pose.elevation_high
    start, observation = face(50.0, high), see(face(50.0, high + 8.0))
    assert np.rad2deg(read_elevations(search(start, observation)[0])) <= high + 0.1
    free = replace_fields(CONFIG, {"pose": {"elevation_high": high + 30.0}})
    wider, _ = search(start, observation, config=free)
    assert np.rad2deg(read_elevations(wider)) > high + 3


def predict(**pose):
    changes = {"pose": pose, "render": {"fine_grid": 16}}
    config = replace_fields(CONFIG, changes)
    network = make_network(config)
    dataset = make_dataset(models=3, views=2)
    compiled = make_predictor(network, config)
    return predict_all(compiled, make_state(network, config), dataset)


def test_predictions_take_the_candidate_of_the_largest_posterior(monkeypatch):
    def compare(scene, candidates, *_, **__):
        return 100.0 - 50.0 * jnp.arange(len(candidates)) / max(len(candidates) - 1, 1)

    def take_last(scene, candidates, *_, **__):
        return candidates[-FINALISTS - 1 :][:1]  # viewpoints are behind it

    monkeypatch.setattr(predictor, "compare_poses", compare)
    monkeypatch.setattr(predictor, "find_likeliest", take_last)
    found = predict()
    assert np.allclose(found.poses, found.candidates[:, :, -1], atol=1e-5)
    assert (np.asarray(found.winners) == found.candidates.shape[2] - 1).all()


def test_of_drawn_heads_the_likeliest_is_taken_whatever_the_image():
    found = predict(source="sampled")
    best = found.probabilities.argmax(-1)[..., None, None]
    (picked,) = np.moveaxis(np.take_along_axis(found.candidates, best, axis=2), 2, 0)
    assert np.allclose(found.poses, picked, atol=1e-6)
