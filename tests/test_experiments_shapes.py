"""Analyses of finished runs: correspondences, interpolation, sizes of points.

The network is untrained: figures of quality are in docs/baselines.md.
"""

import dataclasses
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from tiny_runs import make_network, make_state, tiny_config, write_workdir

from dpc_jax.evaluation.alignment import identity_alignment
from dpc_jax.experiments import correspondences, interpolation, point_sizes
from dpc_jax.learning.framing import make_inputs
from dpc_jax.reporting import paper_figures
from dpc_jax.reporting.clouds import DEVIATIONS, HALF_WIDTH, draw_ellipsoids
from dpc_jax.run.trained import load_split, load_trained, predict_points
from dpc_jax.run.workdir import write_alignment

TURN = Rotation.from_euler("z", 30, degrees=True)


def make_config(folder, **data):
    """A tiny config of procedural shapes; 6 of its validation chairs are complete."""
    config = dataclasses.replace(tiny_config(), category="chair")
    sizes = dict(val_models=8, test_models=4, views=1, surface_points=200)
    changed = sizes | {"cache_dir": str(folder / "data")} | data
    return dataclasses.replace(config, data=dataclasses.replace(config.data, **changed))


def write_run(folder, config):
    """A workdir as of a finished run whose network's frame is turned about z."""
    state = make_state(make_network(config), config)
    workdir = write_workdir(folder / "run", config, state=state)
    turn = TURN.as_quat(scalar_first=True)
    write_alignment(workdir, identity_alignment()._replace(rotation=turn))
    return workdir


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run, read back from its workdir."""
    folder = tmp_path_factory.mktemp("finished")
    return load_trained(write_run(folder, make_config(folder)))


@pytest.fixture(autouse=True)
def reading_once(finished, monkeypatch):
    """Every workdir holds that run, which need not be restored again."""
    for module in (correspondences, interpolation, point_sizes):
        monkeypatch.setattr(module, "load_trained", lambda workdir: finished)


def test_clouds_are_those_of_the_network_in_the_object_frame(finished):
    images, masks = correspondences.read_first_views(load_split(finished, "test"))
    inputs = make_inputs(images, masks, network=finished.network)
    output = jax.jit(finished.network.apply)(finished.state.params, inputs)
    expected = TURN.apply(np.asarray(output["points"]).reshape(-1, 3))
    points = predict_points(finished, images, masks)
    assert points.shape == (4, 24, 3)
    # Batches of another size sum in another order, in float32.
    np.testing.assert_allclose(points.reshape(-1, 3), expected, atol=1e-5)


def test_correspondences_are_measured_beside_baselines_and_drawn(tmp_path):
    measures, figures = correspondences.run(tmp_path, tmp_path)
    for method in correspondences.METHODS:
        right, follows = (
            measures[f"{text}: {method}"] for text in correspondences.MEASURES
        )
        assert 0 <= right <= 1 and np.isfinite(follows)
    assert [path.parent for path, _ in figures] == [tmp_path]
    for path, caption in figures:
        assert caption.endswith(".")
        with Image.open(path) as picture:
            assert min(picture.size) > 200


def test_the_way_between_images_begins_and_ends_at_their_predictions(finished):
    views = correspondences.read_first_views(load_split(finished, "test"))
    images, masks = (array[:2] for array in views)
    way = interpolation.interpolate(finished, images, masks)
    assert way.shape == (interpolation.STEPS + 1, 24, 3)
    # The same sums in batches of another size, in float32.
    np.testing.assert_allclose(
        way[[0, -1]], predict_points(finished, images, masks), atol=1e-6
    )
    halfway = way[interpolation.STEPS // 2]
    assert np.abs(halfway - (way[0] + way[-1]) / 2).max() > 1e-6  # tanh, leaky ReLU


def test_interpolation_is_measured_and_drawn(tmp_path):
    measures, ((strip, _),) = interpolation.run(tmp_path, tmp_path)
    assert measures[interpolation.LARGEST_STEP] >= 1
    with Image.open(strip) as picture:
        assert picture.width > 1000


def test_an_even_way_has_no_larger_step():
    share = np.linspace(0, 1, 9)[:, None, None]
    way = share * np.random.default_rng(0).normal(size=(1, 5, 3))
    assert interpolation.measure_steps(way[None]) == pytest.approx(1.0)
    jump = np.repeat(way[[0, -1]], 5, axis=0)  # 8 of the 9 frames stand still
    assert interpolation.measure_steps(jump[None]) == pytest.approx(9.0)


def test_pairs_are_of_different_images():
    pairs = interpolation.draw_pairs(100)
    assert len(np.unique(pairs)) == pairs.size == 2 * interpolation.PAIRS
    with pytest.raises(ValueError, match="at least two test images.*there are 1"):
        interpolation.draw_pairs(1)


def test_a_run_that_has_not_ended_is_refused(tmp_path):
    write_workdir(tmp_path / "run", make_config(tmp_path))
    with pytest.raises(ValueError, match="Expected a finished run in"):
        load_trained(tmp_path / "run")


def test_shapes_without_known_parts_are_refused(finished, tmp_path):
    run = finished._replace(config=make_config(tmp_path, meshes="somewhere"))
    with pytest.raises(ValueError, match="parts are known, but this one"):
        correspondences.check_parts(run)


def test_points_have_the_covariances_that_they_were_rendered_with():
    points = np.zeros((2, 1, 3, 3))
    with_sigmas = SimpleNamespace(points=points, sizes=np.full((2, 1, 3), 2.0))
    without = SimpleNamespace(points=points, sizes=None)
    for found in (
        point_sizes.find_covariances(with_sigmas, 9.0, grid=4),
        point_sizes.find_covariances(without, 2.0, grid=4),
    ):
        np.testing.assert_allclose(found, np.tile(0.25 * np.eye(3), (2, 1, 3, 1, 1)))


def write_error(folder, kind, count, error):
    """The files of a finished run that the figure of errors reads."""
    config = tiny_config(point_size=kind, num_points=count)
    return write_workdir(folder / f"{kind}{count}", config, metrics=error)


def test_errors_of_all_kinds_of_points_are_drawn_over_their_number(
    tmp_path, monkeypatch
):
    def draw_gaussians(shapes, path):
        assert shapes == {"": "10", "sigma": "sigma20"}  # of first runs
        return path

    monkeypatch.setattr(point_sizes, "predict_gaussians", lambda workdir: workdir.name)
    monkeypatch.setattr(paper_figures, "draw_gaussians", draw_gaussians)
    workdirs = [
        write_error(tmp_path, kind, count, {"projection_error": 0.1})
        for kind in ("", "sigma")
        for count in (20, 60)
    ]
    unknown = write_error(tmp_path, "", 10, {})
    _, ((path, _), _) = point_sizes.run(tmp_path, [unknown, *workdirs])
    assert "<svg" in path.read_text() and "learned isotropic" in path.read_text()


def test_gaussians_of_test_objects_are_drawn_under_the_input(
    finished, tmp_path, monkeypatch
):
    monkeypatch.setattr(point_sizes, "read_config", lambda workdir: finished.config)
    first, *_ = shapes = point_sizes.predict_gaussians(tmp_path)
    monkeypatch.setattr(point_sizes, "predict_gaussians", lambda workdir: shapes)
    # Without a report there is no figure of errors.
    _, ((path, _),) = point_sizes.run(tmp_path, [tmp_path])
    with Image.open(path) as picture:
        assert np.asarray(picture.convert("L")).std() > 5
    # Turned with the frame, hand-tuned Gaussians stay round.
    np.testing.assert_allclose(
        first.covariances[0], first.covariances[0, 0, 0] * np.eye(3), atol=1e-12
    )


def test_a_sphere_is_drawn_round_and_hides_what_is_behind_it():
    sigma = 0.1
    points = [[0.0, 0, 0], [-0.3, 0, 0]]  # the viewer is at +x
    red, blue = [1.0, 0, 0], [0.0, 0, 1]
    picture = draw_ellipsoids(
        points,
        np.array([np.eye(3), np.diag([0, 4, 1])]) * sigma**2,
        [red, blue],
        view_deg=(0, 0),
    )
    side = len(picture)
    is_red = (picture[..., 0] > 0) & (picture[..., 2] == 0)
    radius = DEVIATIONS * sigma * side / (2 * HALF_WIDTH)
    # A pixel more or less on the rim.
    assert is_red.sum() == pytest.approx(np.pi * radius**2, rel=0.02)
    is_blue = (picture[..., 2] > 0) & (picture[..., 0] == 0)
    assert is_blue[side // 2].sum() == pytest.approx(2 * radius, abs=3)
    assert not is_blue[side // 2, side // 2]
