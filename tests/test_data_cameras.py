"""Views off the centre and of their own focal lengths; other sets as they were."""

import dataclasses

import numpy as np
import pytest
import trimesh

from dpc_jax.data import DataSpec, load_or_render, viewpoints, views
from dpc_jax.data.dataset import locate_cache
from dpc_jax.data.sources import open_source


def make_spec(**own: float) -> DataSpec:
    small = DataSpec("car", models=1, views=3, image_size=32, surface_points=100)
    return dataclasses.replace(small, **own)


@pytest.mark.parametrize("shift", [(0.1, 0.0, 0.0), (0.0, -0.08, 0.1)])
def test_a_moved_sphere_is_where_the_formula_says(shift):
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    rotation = viewpoints.look_at_rotation(0.4, 0.3)
    lights = views.draw_lights(np.random.default_rng(0))
    seen = views.render_view(
        sphere, rotation, lights=lights, image_size=64, translation=shift
    )
    rows, cols = np.mgrid[:64, :64]
    weights = seen.mask / seen.mask.sum(dtype=float)
    x, y, z = shift
    expected = np.array([x, y]) * 1.875 / (2 + z) * 64 + 31.5
    # Perspective stretches a sphere off the axis outwards by a few hundredths.
    found = [(cols * weights).sum(), (rows * weights).sum()]
    np.testing.assert_allclose(found, expected, atol=0.05)
    nearest = seen.depth[seen.mask == 255].min()
    assert nearest == pytest.approx(2 + z - 0.1, abs=2e-3)  # a pixel is 0.017 wide


def test_a_set_keeps_the_cameras_that_its_views_were_rendered_with(tmp_path):
    own = make_spec(offset=0.1, focal_spread=0.2)
    plain = make_spec()
    moved, still = (
        load_or_render(spec, cache_dir=tmp_path, processes=1, progress=False)
        for spec in (own, plain)
    )
    assert still.translations is None and still.focal_lengths is None
    translations = np.asarray(moved.translations)
    focal_lengths = np.asarray(moved.focal_lengths)
    assert translations.shape == (1, 3, 3) and focal_lengths.shape == (1, 3)
    assert 0 < np.abs(translations).max() <= 0.1
    assert len(np.unique(focal_lengths)) == 3
    assert (np.abs(focal_lengths / 1.875 - 1) <= 0.2).all()
    # The same object from the same sides.
    np.testing.assert_array_equal(moved.quaternions[0], still.quaternions[0])
    np.testing.assert_array_equal(moved.surfaces[0], still.surfaces[0])
    assert (np.asarray(moved.masks) != np.asarray(still.masks)).any()


def test_sets_of_other_cameras_have_other_keys(tmp_path):
    sources = [open_source(make_spec(**own)) for own in ({}, {"offset": 0.1})]
    keys = {locate_cache(s, s.list_models(), tmp_path).name for s in sources}
    assert len(keys) == 2
