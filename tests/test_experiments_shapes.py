"""Correspondences and interpolation of a finished run: what is written, and of what.

The network is untrained: figures of quality are in docs/baselines.md.
"""

import dataclasses
import json

import jax
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from tiny_runs import compiling_quickly, make_network, make_state, tiny_config

from dpc_jax.evaluation.alignment import identity_alignment
from dpc_jax.experiments import correspondences, interpolation, labelled_shapes
from dpc_jax.learning.predictions import make_inputs
from dpc_jax.learning.training.checkpoints import Checkpoints
from dpc_jax.run.finished import load_split, predict_points, read_run
from dpc_jax.run.workdir import claim_workdir, write_alignment

TURN = Rotation.from_euler("z", 30, degrees=True)


def make_config(folder, category="chair", **data):
    """A tiny config of procedural shapes; 6 of its validation chairs are complete."""
    config = dataclasses.replace(tiny_config(), category=category)
    sizes = dict(val_models=8, test_models=4, views=1, surface_points=200)
    changed = sizes | {"cache_dir": str(folder / "data"), "processes": 1} | data
    return dataclasses.replace(config, data=dataclasses.replace(config.data, **changed))


def write_run(folder, config):
    """A workdir as of a finished run whose network's frame is turned about z."""
    workdir = claim_workdir(folder / "run", config)
    checkpoints = Checkpoints(workdir / "checkpoints")
    checkpoints.save(make_state(make_network(config), config), seconds=0.0)
    checkpoints.close()
    turn = TURN.as_quat(scalar_first=True)
    write_alignment(workdir, identity_alignment()._replace(rotation=turn))
    return workdir


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run, read back from its workdir."""
    folder = tmp_path_factory.mktemp("finished")
    with compiling_quickly():
        return read_run(write_run(folder, make_config(folder)))


@pytest.fixture(autouse=True)
def reading_once(finished, monkeypatch):
    """Every workdir holds that run, which need not be restored again."""
    for module in (correspondences, interpolation):
        monkeypatch.setattr(module, "read_run", lambda workdir: finished)
    with compiling_quickly():
        yield


def test_clouds_are_those_of_the_network_in_the_object_frame(finished):
    run = finished
    images, masks = labelled_shapes.read_first_views(load_split(run, "test"))
    inputs = make_inputs(images, masks, network=run.network)
    output = jax.jit(run.network.apply)(run.state.params, inputs)
    expected = TURN.apply(np.asarray(output["points"]).reshape(-1, 3))
    points = predict_points(run, images, masks)
    assert points.shape == (4, 24, 3)
    # Batches of another size sum in another order, in float32.
    np.testing.assert_allclose(points.reshape(-1, 3), expected, atol=1e-5)


def test_correspondences_are_measured_beside_baselines_and_drawn(tmp_path):
    metrics, figures = correspondences.run(tmp_path, tmp_path)
    written = json.loads((tmp_path / "correspondences.json").read_text())
    assert written["right_part"] == pytest.approx(metrics["right_part"])
    assert metrics["shapes"] == 4 and metrics["category"] == "chair"
    assert metrics["points"] >= correspondences.LEAST
    assert set(metrics["by"]) == set(correspondences.METHODS)
    for values in metrics["by"].values():
        assert 0 <= values["right_part"] <= 1
        assert len(values["right_part_by_keypoint"]) == 10
    # The nearest points to a keypoint are nearer than any others.
    nearest = metrics["by"]["own"]["distance"]
    assert all(v["distance"] >= nearest for v in metrics["by"].values())
    assert [path.parent for path in figures] == [tmp_path] * 2
    for path in figures:
        with Image.open(path) as picture:
            assert min(picture.size) > 200


def test_the_way_between_images_begins_and_ends_at_their_predictions(finished):
    run = finished
    views = labelled_shapes.read_first_views(load_split(run, "test"))
    images, masks = (array[:2] for array in views)
    way = interpolation.interpolate(run, images, masks)
    assert way.shape == (interpolation.STEPS + 1, 24, 3)
    # The same sums in batches of another size, in float32.
    np.testing.assert_allclose(
        way[[0, -1]], predict_points(run, images, masks), atol=1e-6
    )
    halfway = way[interpolation.STEPS // 2]
    assert np.abs(halfway - (way[0] + way[-1]) / 2).max() > 1e-6  # tanh, leaky ReLU


def test_interpolation_is_measured_and_drawn_as_strip_and_animation(tmp_path):
    metrics, (strip, animation) = interpolation.run(tmp_path, tmp_path)
    written = json.loads((tmp_path / "interpolation.json").read_text())
    assert written == pytest.approx(metrics)
    assert metrics["largest_step"] >= 1 and metrics["detour"] >= 1
    assert metrics["pairs"] == 2
    with Image.open(strip) as picture:
        assert picture.width > 1000
    with Image.open(animation) as frames:
        assert frames.width >= 600 and frames.info["loop"] == 0
        assert frames.n_frames > 1


def test_a_straight_even_way_has_no_detour_and_no_larger_step():
    share = np.linspace(0, 1, 9)[:, None, None]
    way = share * np.random.default_rng(0).normal(size=(1, 5, 3))
    straight = interpolation.measure_ways(way[None])
    assert straight["largest_step"] == pytest.approx(1.0)
    assert straight["detour"] == pytest.approx(1.0)
    jump = np.repeat(way[[0, -1]], 5, axis=0)  # 8 of the 9 frames stand still
    assert interpolation.measure_ways(jump[None])["largest_step"] == pytest.approx(9.0)


def test_pairs_are_of_different_images():
    pairs = interpolation.draw_pairs(100)
    assert len(np.unique(pairs)) == pairs.size == 2 * interpolation.PAIRS
    with pytest.raises(ValueError, match="at least two test images.*there are 1"):
        interpolation.draw_pairs(1)
    with pytest.raises(ValueError, match="with all keypoints, but there are 1"):
        correspondences.draw_pairs(1)


def test_a_run_that_has_not_ended_is_refused(tmp_path):
    claim_workdir(tmp_path / "run", make_config(tmp_path))
    with pytest.raises(ValueError, match="Expected a finished run in"):
        read_run(tmp_path / "run")


def test_shapes_without_known_parts_are_refused(finished, tmp_path):
    run = finished._replace(config=make_config(tmp_path, meshes="somewhere"))
    with pytest.raises(ValueError, match="parts are known, but this one"):
        labelled_shapes.name_keypoints(run)


def test_pairs_of_templates_are_the_same_in_every_run():
    np.testing.assert_array_equal(
        correspondences.draw_pairs(9), correspondences.draw_pairs(9)
    )
