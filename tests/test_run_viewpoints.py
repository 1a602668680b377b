"""Upright viewpoints: what heads can predict, and a warning where cameras differ."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tiny_runs import make_dataset, tiny_config

from dpc_jax.config import check, replace_fields
from dpc_jax.data.viewpoints import (
    look_at_rotation,
    matrix_to_quaternion,
    measure_stands,
)
from dpc_jax.learning.half_turns import find_half_turns, turn_candidates
from dpc_jax.run.setup import check_viewpoints

FRAME = Rotation.random(random_state=3)  # poses of images may be in any frame


def draw_poses(count, *, low, high):
    rng = np.random.default_rng(0)
    azimuths = rng.uniform(0, 2 * np.pi, count)
    elevations = np.deg2rad(rng.uniform(low, high, count))
    angles = zip(azimuths, elevations, strict=True)
    cameras = Rotation.from_matrix([look_at_rotation(*pair) for pair in angles])
    return matrix_to_quaternion((cameras * FRAME).as_matrix()), np.rad2deg(elevations)


def test_rolls_and_elevations_are_found_in_any_frame():
    poses, elevations = draw_poses(100, low=-20, high=40)
    rolls, found = measure_stands(poses)
    assert np.allclose(found, elevations, atol=1e-6)
    assert np.abs(rolls).max() < 1e-6


@pytest.mark.parametrize(
    ("high", "settings", "is_warned"),
    [
        (40, {}, False),
        (75, {}, True),
        (75, {"pose": {"elevation_high": 75.0}}, False),
        (75, {"pose": {"head": "quaternion"}}, False),
        (75, {"pose": {"source": "given"}}, False),
        (75, {"data": {"images": ""}}, False),  # rendered from where heads can see
    ],
)
def test_cameras_that_heads_cannot_predict_are_warned_of(high, settings, is_warned):
    config = tiny_config(head="viewpoint", images="images")
    config = replace_fields(config, settings)
    poses, _ = draw_poses(12, low=-20, high=high)
    poses = poses.reshape(4, 3, 4).astype(np.float32)
    dataset = make_dataset(models=4, views=3)._replace(quaternions=poses)
    warnings = check_viewpoints(config, {"train": dataset})
    assert len(warnings) == is_warned
    if is_warned:
        assert "between -20 and 40 degrees" in warnings[0]
        without = dataset._replace(quaternions=None)
        assert not check_viewpoints(config, {"train": without})


def test_half_turns_of_upright_viewpoints_stay_upright():
    turns = find_half_turns(jnp.eye(3), 2)
    assert turns.tolist() == [[1, 0, 0, 0], [0, 0, 0, 1]]
    heads = [look_at_rotation(1.0, 0.5), look_at_rotation(2.0, -0.2)]
    found = turn_candidates(jnp.array(matrix_to_quaternion(np.stack(heads))), turns)
    turned = [look_at_rotation(1.0 + np.pi, 0.5), look_at_rotation(2.0 + np.pi, -0.2)]
    expected = matrix_to_quaternion(np.stack(heads + turned))
    overlap = np.abs(np.sum(np.asarray(found) * expected, axis=1))
    assert np.allclose(overlap, 1, atol=1e-6)


def test_a_range_of_elevations_that_is_none_is_refused():
    config = tiny_config(elevation_low=40.0, elevation_high=-20.0)
    with pytest.raises(ValueError, match="elevation_high must be above pose.elev"):
        check(config)
