"""Surfaces around clouds: closed, filled, where the points were drawn from."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from dpc_jax.evaluation.wrapping import wrap_points
from dpc_jax.shapes.procedural import make_shape


def wrap(points, **options):
    return trimesh.Trimesh(*wrap_points(points, **options), process=False)


def test_points_of_a_sphere_give_a_solid_ball_whatever_floats_in_it():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(3000, 3))
    points *= 0.4 / np.linalg.norm(points, axis=1, keepdims=True)
    points[:100] *= rng.uniform(0, 0.9, (100, 1))
    ball = wrap(points)
    assert ball.is_watertight and ball.is_winding_consistent
    assert ball.body_count == 1 and len(ball.faces) <= 20_000
    # Within a cell, 0.01.
    radius = np.linalg.norm(ball.vertices, axis=1)
    assert abs(radius.mean() - 0.4) < 0.006 and radius.std() < 0.01
    assert ball.volume == pytest.approx(4 / 3 * np.pi * 0.4**3, rel=0.05)


def test_thin_parts_stay_and_a_gap_between_them_too():
    line = np.linspace(-0.4, 0.4, 400)[:, None] * [0, 0, 1]
    legs = np.concatenate([line + [x, 0, 0] for x in (-0.2, 0.2)])
    mesh = wrap(legs)
    assert mesh.is_watertight and mesh.body_count == 2
    np.testing.assert_allclose(mesh.extents[1:], [0.012, 0.812], atol=0.015)


def test_a_fitted_sheet_with_fewer_points_on_one_side_is_whole():
    rng = np.random.default_rng(0)
    dense, sparse = rng.uniform(-0.4, 0.4, (3000, 3)), rng.uniform(-0.4, 0.4, (900, 3))
    sheet = np.concatenate([dense - [0.4, 0, 0], sparse + [0.4, 0, 0]]) * [0.5, 1, 0]
    mesh = wrap(sheet, is_fitted=True)
    assert mesh.is_watertight and mesh.body_count == 1
    assert mesh.euler_number == 2  # of a solid without holes; else less by 2 for each
    assert wrap(sheet).euler_number < 0


def test_a_surface_is_as_near_as_its_points_and_has_no_more_faces_than_asked():
    shape = make_shape("chair", 5)
    points, others = (
        np.asarray(trimesh.sample.sample_surface(shape, count, seed=count)[0])
        for count in (4000, 100_000)
    )
    truth = KDTree(others)
    mesh = wrap(points)
    assert mesh.is_watertight and 10_000 < len(mesh.faces) <= 20_000
    drawn = np.asarray(trimesh.sample.sample_surface(mesh, 1000, seed=0)[0])
    assert truth.query(drawn)[0].mean() < 0.01  # a cell


@pytest.mark.parametrize(
    "points",
    [np.zeros((1, 3)), np.zeros((5, 3)), [[-30.0, 0, 0], [30, 20, 10]], np.eye(3)],
    ids=["one", "alike", "far", "few"],
)
def test_few_or_odd_points_have_a_closed_surface_too(points):
    mesh = wrap(points)
    assert mesh.is_watertight and mesh.volume > 0
