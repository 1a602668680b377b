"""Procedural shapes: canonical, varied, and with a front."""

import numpy as np
import pytest

from dpc_jax.data import viewpoints, views
from dpc_jax.shapes import procedural

SEEDS = range(12)


def see(category, seed, azimuth, size=48):
    mesh = procedural.make_shape(category, seed)
    lights = views.Lights(np.array([[0.0, 0.0, 1.0]]), np.array([0.6]), 0.4)
    rotation = viewpoints.look_at_rotation(azimuth, 0.0)
    return views.render_view(mesh, rotation, lights=lights, image_size=size)


@pytest.mark.parametrize("category", procedural.CATEGORIES)
def test_shapes_are_centred_with_a_box_diagonal_of_one(category):
    for seed in SEEDS:
        mesh = procedural.make_shape(category, seed)
        low, high = mesh.bounds
        np.testing.assert_allclose(np.linalg.norm(high - low), 1.0, atol=1e-12)
        np.testing.assert_allclose(low + high, 0.0, atol=1e-12)
        assert np.isfinite(mesh.vertices).all()
        assert mesh.area_faces.min() > 0
        assert 80 < len(mesh.faces) < 2000
        colors = np.unique(mesh.visual.face_colors, axis=0)
        assert len(colors) >= (1 if category == "chair" else 3)  # wholly wooden chairs


@pytest.mark.parametrize("category", procedural.CATEGORIES)
def test_the_same_seed_gives_the_same_shape_and_another_seed_another(category):
    first, again = (procedural.make_shape(category, 5) for _ in range(2))
    np.testing.assert_array_equal(first.vertices, again.vertices)
    np.testing.assert_array_equal(first.faces, again.faces)
    np.testing.assert_array_equal(first.visual.face_colors, again.visual.face_colors)
    masks = np.array([see(category, seed, np.pi / 2).mask > 127 for seed in SEEDS])
    for i in SEEDS:
        for j in range(i):
            union = (masks[i] | masks[j]).sum()
            # no two side views agree to more than 98 % of their pixels
            assert (masks[i] & masks[j]).sum() < 0.98 * union


@pytest.mark.parametrize("category", procedural.CATEGORIES)
def test_front_and_back_differ_in_silhouette_and_colour(category):
    for seed in SEEDS:
        side = see(category, seed, np.pi / 2).mask > 127
        changed = (side != side[:, ::-1]).sum() / side.sum()
        assert changed > 0.04, f"{category} {seed}: {changed:.3f}"
        front, back = (see(category, seed, a).image.astype(int) for a in (0, np.pi))
        assert (np.abs(front - back[:, ::-1]).max(axis=-1) > 30).sum() > 10


def test_chairs_have_their_back_at_the_back_and_airplanes_their_fin():
    for category in ("chair", "airplane"):
        for seed in SEEDS:
            mesh = procedural.make_shape(category, seed)
            top = mesh.vertices[mesh.vertices[:, 2] > 0.9 * mesh.bounds[1, 2], 0]
            assert top.max() < 0.1, f"{category} {seed}"
