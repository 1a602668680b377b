"""The mean shape of a training set, as a prediction of every test shape."""

import numpy as np
import pytest

from dpc_jax.config import build_config, replace_fields
from dpc_jax.data import load_or_render
from dpc_jax.evaluation.training_shapes import average_surfaces, take_fullest
from dpc_jax.experiments import results
from dpc_jax.experiments.results import (
    Outcome,
    Results,
    measure_mean_shape,
    measure_mean_shapes,
)
from dpc_jax.experiments.runs import Request
from dpc_jax.run.setup import make_data_specs


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    """Of tiny data that are prepared."""
    data = {
        "image_size": 16,
        "models": 6,
        "val_models": 2,
        "test_models": 3,
        "views": 1,
        "surface_points": 300,
        "cache_dir": str(tmp_path_factory.mktemp("data")),
        "processes": 1,
    }
    config = replace_fields(build_config("car", "known_pose"), {"data": data})
    for spec in make_data_specs(config).values():
        load_or_render(
            spec, cache_dir=config.data.cache_dir, processes=1, progress=False
        )
    return config


def test_cells_count_shapes_once_and_have_the_mean_of_all_points():
    first = np.array([[0.3, 0.3, 0.3], [0.35, 0.3, 0.3], [-0.4, 0, 0]])
    second = np.array([[0.4, 0.3, 0.3], [0.4, 0.3, -0.3]])
    shares, places = average_surfaces([first, second], side=2)
    by_cell = shares.reshape(2, 2, 2)
    assert by_cell[1, 1, 1] == 1.0 and by_cell[1, 1, 0] == by_cell[0, 1, 1] == 0.5
    assert shares.sum() == 2.0
    np.testing.assert_allclose(places[np.argmax(shares)], [0.35, 0.3, 0.3])
    fullest = take_fullest(shares, places, 1)
    np.testing.assert_allclose(fullest, [[0.35, 0.3, 0.3]])
    assert len(take_fullest(shares, places, 8)) == 3  # empty cells are none


def test_the_row_is_near_the_best_single_guess(config):
    found = measure_mean_shape(config)
    assert found["chamfer"] == pytest.approx(found["precision"] + found["coverage"])
    # Cars of one category: nearer than 10 diagonals in a hundred, and not equal.
    assert 1 < found["chamfer"] < 12


def test_without_its_data_it_says_where_to_look(config, tmp_path):
    elsewhere = replace_fields(config, {"data": {"cache_dir": str(tmp_path)}})
    with pytest.raises(ValueError, match="Expected the data of a finished run in"):
        measure_mean_shape(elsewhere)
    assert not any(tmp_path.iterdir())


def test_it_is_measured_once_and_again_for_other_data(config, tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(
        results, "measure_mean_shape", lambda config: calls.append(config) or {"n": 1.0}
    )
    request = Request(("known_pose",), categories=("car",), seeds=(0,))

    def measure(config):
        outcomes = {
            run.name: Outcome(run, tmp_path, config, {"chamfer": 4.0})
            for run in request.list_runs()
        }
        return measure_mean_shapes(Results(request, outcomes), tmp_path / "kept")

    assert measure(config) == measure(config) == {"car": {"n": 1.0}}
    assert len(calls) == 1
    measure(replace_fields(config, {"data": {"models": 7}}))
    assert len(calls) == 2
    (record,) = (tmp_path / "kept").iterdir()
    record.write_text("{")
    measure(config)
    assert len(calls) == 3
