"""Where a category's cameras stand: candidates from elsewhere are handicapped."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tiny_runs import make_batch, make_network, make_state, make_step, tiny_config

from dpc_jax.data.viewpoints import look_at_rotation
from dpc_jax.learning.choice import viewpoints
from dpc_jax.learning.choice.viewpoints import (
    count_viewpoints,
    find_axis,
    find_handicaps,
    measure_stands,
    start_viewpoints,
)
from dpc_jax.learning.devices import AXIS

pytestmark = pytest.mark.usefixtures("quickly")
FRAME = Rotation.random(random_state=1)  # the network's, any
UP = FRAME.inv().apply([0.0, 0.0, 1.0])


def as_poses(rotations):
    return jnp.asarray(np.roll(rotations.as_quat(), 1, axis=-1), jnp.float32)


def draw_cameras(count, *, seed=0, low=-20.0, high=40.0):
    """Rotations of upright cameras all around, and their elevations in radians."""
    rng = np.random.default_rng(seed)
    azimuths = rng.uniform(0, 2 * np.pi, count)
    elevations = np.deg2rad(rng.uniform(low, high, count))
    made = [
        look_at_rotation(*angles) for angles in zip(azimuths, elevations, strict=True)
    ]
    matrices = np.stack([np.asarray(m).reshape(3, 3) for m in made])
    return Rotation.from_matrix(matrices) * FRAME, elevations


@jax.jit
def count_batches(poses):
    """Sums after batches [steps, devices, n, 4], of devices side by side."""

    def count(own):
        def take(seen, batch):
            return count_viewpoints(seen, batch), None

        return jax.lax.scan(take, start_viewpoints(), own)[0]

    return jax.tree.map(lambda a: a[0], jax.vmap(count, 1, axis_name=AXIS)(poses))


@pytest.fixture(scope="module")
def seen():
    rotations, _ = draw_cameras(1600)
    return count_batches(as_poses(rotations).reshape(100, 1, 16, 4))


def test_upright_cameras_tell_the_axis_they_stand_around_and_where(seen):
    # 1600 directions of rows, all square to the axis but for float32.
    assert np.allclose(find_axis(seen), UP, atol=1e-4)
    rotations, elevations = draw_cameras(50, seed=1)
    elevation, roll = measure_stands(as_poses(rotations), find_axis(seen))
    assert np.allclose(elevation, elevations, atol=1e-3)
    assert np.abs(roll).max() < 1e-3
    # A camera turned about its line of sight has that roll and the same elevation.
    turned = Rotation.from_rotvec([0, 0, 0.6]) * rotations
    elevation, roll = measure_stands(as_poses(turned), find_axis(seen))
    assert np.allclose(elevation, elevations, atol=1e-3)
    assert np.allclose(np.abs(roll), 0.6, atol=1e-3)


def test_cameras_where_the_others_are_are_hardly_handicapped_and_others_are(seen):
    rotations, elevations = draw_cameras(200, seed=2)
    own = find_handicaps(as_poses(rotations)[:, None], seen, jnp.array(0.2))
    assert own.shape == (200, 1)
    assert own.min() >= 1 and own.mean() < 1.1
    # The object turned about an axis between up and front, as kinds of chairs are.
    oblique = FRAME.inv() * Rotation.from_rotvec(
        np.pi * np.array([1, 0, 1]) / np.sqrt(2)
    )
    turned = rotations * oblique * FRAME
    assert find_handicaps(as_poses(turned)[:, None], seen, 0.2).mean() > 1.5
    # The mirror pose looks from below where the true one looks from above.
    below, _ = draw_cameras(50, seed=3, low=-40.0, high=-32.0)
    assert find_handicaps(as_poses(below)[:, None], seen, 0.2).min() > 1.4
    upside_down = Rotation.from_rotvec([0, 0, np.pi]) * rotations
    assert find_handicaps(as_poses(upside_down)[:, None], seen, 0.2).min() > 1.9


def test_a_half_turn_about_the_axis_itself_is_no_handicap(seen):
    rotations, _ = draw_cameras(20, seed=4)
    turned = rotations * Rotation.from_rotvec(np.pi * UP)
    both = jnp.stack([as_poses(rotations), as_poses(turned)], axis=1)
    plain, other = find_handicaps(both, seen, jnp.array(0.2)).T
    # At the edge of a bin one of them may fall into the next one.
    assert (jnp.abs(plain - other) < 1e-4).mean() > 0.9


def test_where_cameras_stand_anywhere_nothing_is_handicapped_much():
    poses = as_poses(Rotation.random(16_000, random_state=5))
    even = count_batches(poses.reshape(1000, 1, 16, 4))
    found = find_handicaps(poses[:500, None], even, jnp.array(0.2))
    # 1600 of them count, by 18 and 24 bins: spreads of a few tenths of a nat.
    assert 1 <= found.min() and found.mean() < 1.15


def test_nothing_seen_yet_is_no_handicap():
    poses = as_poses(Rotation.random(9, random_state=6)).reshape(3, 3, 4)
    found = find_handicaps(poses, start_viewpoints(), jnp.array(0.5))
    assert np.allclose(found, 1, atol=1e-5)


def test_devices_count_what_one_counts(seen):
    rotations, _ = draw_cameras(1600)
    apart = count_batches(as_poses(rotations).reshape(100, 4, 4, 4))
    for one, other in zip(seen, apart, strict=True):
        assert np.allclose(one, other, rtol=1e-4, atol=2.0)  # a camera at a bin's edge


@pytest.mark.parametrize("weight", [0.0, 0.5])
def test_a_training_step_counts_its_winners_where_it_is_asked_for(weight):
    config = tiny_config(viewpoint_weight=weight, viewpoint_from=0.0)
    network = make_network(config)
    step, state = make_step(network, config), make_state(network, config)
    state, _ = step(state, make_batch())
    if not weight:
        assert state.viewpoints is None
        return
    rolls = state.viewpoints.rolls
    assert float(rolls.sum()) == pytest.approx(4)  # two objects with two views
    assert float(state.viewpoints.elevations.sum()) == pytest.approx(4)
    state, metrics = step(state, make_batch(seed=1))
    assert float(state.viewpoints.rolls.sum()) == pytest.approx(8, rel=0.02)
    assert np.isfinite(metrics["loss"])


def test_a_handicap_changes_the_winner(monkeypatch):
    config = tiny_config(viewpoint_weight=1.0, viewpoint_from=0.0)
    network = make_network(config)
    batch = make_batch()
    winners = []
    for factors in ([1.0, 1.0, 1.0], [1e6, 1e6, 1.0], [1.0, 1e6, 1e6]):
        monkeypatch.setattr(
            viewpoints,
            "find_handicaps",
            lambda candidates, *_, f=factors: jnp.tile(
                jnp.array(f), (len(candidates), 1)
            ),
        )
        step, state = make_step(network, config), make_state(network, config)
        winners.append(step(state, batch)[1]["winners"].tolist())
    assert winners[1] == [2] * 4 and winners[2] == [0] * 4
    assert winners[0] not in winners[1:]
