"""Surfaces of occupancies: where they lie, how they are sampled and chosen."""

import numpy as np
import pytest
import trimesh

from dpc_jax.evaluation.surfaces import extract_surface, sample_surface, tune_threshold


def fill_box(low, high):
    """A volume of a box between cell borders, 1 inside."""
    cells = np.zeros((16, 16, 16), np.float32)
    cells[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = 1
    return cells


def blur_ball(radius, width):
    """Occupancies that fall from 1 to 0 over a width around a ball's surface."""
    centers = (np.arange(24) + 0.5) / 24 - 0.5
    away = np.linalg.norm(np.stack(np.meshgrid(*[centers] * 3), -1), axis=-1)
    return np.clip(0.5 + (radius - away) / width, 0, 1).astype(np.float32)


def test_a_box_has_its_faces_on_the_borders_of_its_cells():
    """At one half the surface lies midway between the centres of two cells."""
    vertices, faces = extract_surface(fill_box((2, 4, 6), (10, 8, 16)), 0.5)
    np.testing.assert_allclose(vertices.min(0), [-0.375, -0.25, -0.125], atol=1e-6)
    # The last one ends at the rim of the volume, beyond which it counts as empty.
    np.testing.assert_allclose(vertices.max(0), [0.125, 0.0, 0.5], atol=1e-6)
    mesh = trimesh.Trimesh(vertices, faces)
    assert mesh.is_watertight
    # Seen from outside faces turn counter-clockwise: the volume is positive.
    assert mesh.volume == pytest.approx(0.5 * 0.25 * 0.625, rel=0.05)  # cut edges


@pytest.mark.parametrize("threshold", [0.3, 0.7])
def test_the_surface_of_a_blurred_ball_is_where_it_passes_the_threshold(threshold):
    points = sample_surface(blur_ball(0.3, width=0.15), threshold, count=500)
    radius = np.linalg.norm(points, axis=1)
    expected = 0.3 + (0.5 - threshold) * 0.15
    # Flat triangles across cells of 1/24, diagonal 0.072: a sagitta of 0.0025.
    np.testing.assert_allclose(radius, expected, atol=0.003)


def test_samples_are_uniform_by_area_and_the_same_for_a_seed():
    cells = fill_box((0, 0, 4), (16, 16, 12))  # two faces of 1, four of 1/2
    points = sample_surface(cells, 0.5, count=8000)
    np.testing.assert_array_equal(points, sample_surface(cells, 0.5, count=8000))
    flat = np.mean(np.isclose(np.abs(points[:, 2]), 0.25, atol=1e-3))
    mesh = trimesh.Trimesh(*extract_surface(cells, 0.5))
    up = np.abs(mesh.face_normals[:, 2]) > 0.99
    share = mesh.area_faces[up].sum() / mesh.area
    assert 0.4 < share < 0.5
    # 8000 draws deviate by 0.006.
    assert flat == pytest.approx(share, abs=0.02)
    assert np.abs(points).max() <= 0.5 + 1e-6


def test_without_a_surface_the_fullest_cell_stands_for_the_shape():
    cells = np.full((8, 8, 8), 0.1)
    cells[1, 2, 3] = 0.2
    points = sample_surface(cells, 0.5, count=7)
    expected = (np.array([1, 2, 3]) + 0.5) / 8 - 0.5
    np.testing.assert_allclose(points, np.tile(expected, (7, 1)), atol=1e-6)


def test_the_tuned_threshold_gives_the_true_radius():
    """Balls blurred around a radius other than the true one ask for their threshold."""
    truth = [
        trimesh.creation.icosphere(4, radius).vertices for radius in (0.25, 0.3, 0.35)
    ]
    volumes = [blur_ball(r + 0.01, width=0.1) for r in (0.25, 0.3, 0.35)]
    # 0.5 + 0.01/0.1; steps of 1/40, and 2000 samples see the radius to 0.001.
    assert tune_threshold(volumes, truth) == pytest.approx(0.6, abs=0.05)
