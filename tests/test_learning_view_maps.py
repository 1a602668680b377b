"""EPCG: fusion of maps and their comparison with known geometry, what points show."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from data_trees import rotate
from tiny_runs import make_recipe, random_quaternions, tiny_config

from dpc_jax.data import DataSpec, load_or_render
from dpc_jax.data.batches import read_batch
from dpc_jax.data.viewpoints import CORNERS, look_at_rotation
from dpc_jax.data.views import Lights, build_scene, render_view
from dpc_jax.learning.shapes import view_maps
from dpc_jax.learning.shapes.kind import View
from dpc_jax.learning.shapes.view_maps import ViewMaps
from dpc_jax.networks.view_maps import fuse_maps, list_fixed_views, make_planes
from dpc_jax.render import Camera

CONFIG = tiny_config(source="given", depth_weight=1.0, shape="maps")


@pytest.fixture(scope="module")
def corners():
    """Masks and depths [8, 32, 32] of a ball, seen from the corners of a cube."""
    scene = build_scene(trimesh.creation.icosphere(4, radius=0.3))
    dark = Lights(np.zeros((0, 3)), np.zeros(0), 1.0)
    seen = [
        render_view(
            scene, look_at_rotation(*np.deg2rad(angles)), lights=dark, image_size=32
        )
        for angles in CORNERS
    ]
    return np.stack([v.mask for v in seen]), np.stack([v.depth for v in seen])


def true_maps(corners):
    """The maps that see just these depths, and logits of these masks."""
    masks, depths = corners
    plane = np.tile(make_planes(32, 2.0), (8, 1, 1, 1))
    plane[..., 2] = np.where(masks == 255, depths, 2.0)
    return jnp.asarray(plane)[None], jnp.where(masks.reshape(1, -1) == 255, 9.0, -9.0)


def test_fixed_views_are_those_that_the_data_renders():
    expected = [look_at_rotation(*np.deg2rad(angles)) for angles in CORNERS]
    np.testing.assert_allclose(list_fixed_views(), np.stack(expected), atol=1e-6)


def test_depths_of_a_ball_from_all_corners_fuse_to_the_ball(corners):
    maps, logits = true_maps(corners)
    points = fuse_maps(maps, focal_length=1.875, distance=2.0)
    visible = np.asarray(points[0])[np.asarray(logits[0]) > 0]
    radii = np.linalg.norm(visible, axis=1)
    # Pixels whose whole square is covered; at the rim a pixel's mean depth is off by a
    # share of its slope: half a pixel is 0.017 wide there.
    assert np.median(np.abs(radii - 0.3)) < 1e-3
    assert np.quantile(np.abs(radii - 0.3), 0.95) < 0.017
    # And from all sides of it.
    np.testing.assert_allclose(visible.mean(axis=0), 0, atol=0.01)
    assert len(visible) > 8 * 100


def test_maps_of_their_own_views_cost_next_to_nothing(corners):
    maps, logits = true_maps(corners)
    points = fuse_maps(maps, focal_length=1.875, distance=2.0)
    masks, depths = corners
    batch = {"corner_masks": masks[None], "corner_depths": depths[None]}
    recipe = make_recipe(CONFIG)

    @jax.jit
    def compare(maps, logits):
        shapes = ViewMaps(maps, points, logits)
        return shapes.compare({}, batch, recipe=recipe, stage=None)[:2]

    _, terms = compare(maps, logits)
    assert float(terms["pixel_deviation"]) == pytest.approx(0, abs=1e-6)
    # Only pixels of the rim, half covered, whose depth was left at the plane.
    rim = np.sum((masks < 255) & (masks >= 128)) / 8
    assert float(terms["depth"]) < 0.3 * rim + 1e-4
    worse, _ = compare(maps.at[..., 2].add(0.1), logits)
    assert float(worse) > float(compare(maps, logits)[0]) + 10
    shifted = compare(maps.at[..., 0].add(0.01), logits)[1]
    assert float(shifted["pixel_deviation"]) == pytest.approx(0.01 * 32**2, rel=1e-4)


@pytest.mark.parametrize("seed", range(2))
def test_of_visible_points_in_a_pixel_the_nearest_is_seen(seed):
    """Point by point in float64."""
    rng = np.random.default_rng(seed)
    # Half a dozen of them beside the image, and some behind the camera.
    points = rng.uniform(-0.6, 0.6, (60, 3))
    points[:5, 2] -= 2.5
    logits = rng.normal(size=60)
    rotation = random_quaternions(seed, 1)[0] if seed else np.eye(4)[0]
    expected = np.full((6, 6), np.inf)
    for x, y, z in points[logits > 0] @ rotate(rotation).T + [0, 0, 2]:
        column, row = (int(np.floor(6 * (1.875 * a / z + 0.5))) for a in (x, y))
        if z > 0.1 and 0 <= column < 6 and 0 <= row < 6:
            expected[row, column] = min(expected[row, column], z)
    scene = {"points": points, "point_logits": logits}
    image = ViewMaps.render(
        jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), scene),
        View(jnp.asarray(rotation, jnp.float32), Camera(), 6),
        signals=("silhouette", "depth"),
        background_depth=2.5,
    )
    is_covered = np.isfinite(expected)
    assert 0 < is_covered.sum() < 36
    np.testing.assert_array_equal(image.silhouette, is_covered)
    depth = np.where(is_covered, expected, 2.5)
    np.testing.assert_allclose(image.depth, depth, rtol=1e-5)  # float32


def test_judged_are_visible_points_spread_over_all_of_them():
    points = jnp.arange(30.0).reshape(10, 3)
    logits = jnp.where(jnp.arange(10) % 2 == 0, 1.0, -1.0)
    chosen = view_maps.choose_visible(points, logits, count=3)
    np.testing.assert_array_equal(chosen[:, 0] / 3, [0, 2, 6])
    many = np.asarray(view_maps.choose_visible(points, logits, count=20)[:, 0] / 3)
    np.testing.assert_array_equal(np.bincount(many.astype(int))[::2], [4] * 5)
    hidden = jnp.full(10, -5.0).at[4].set(-3.0)
    none = view_maps.choose_visible(points, hidden, count=4)
    np.testing.assert_array_equal(none, jnp.tile(points[4], (4, 1)))


def test_batches_have_the_corner_views_of_their_objects(tmp_path):
    shared = {"category": "car", "models": 3, "views": 2, "image_size": 16}
    plain, more = (
        load_or_render(
            DataSpec(**shared, surface_points=20, corner_views=has_corners),
            cache_dir=tmp_path,
            processes=1,
        )
        for has_corners in (False, True)
    )
    np.testing.assert_array_equal(plain.images, more.images)
    assert plain.corner_masks is None and len(list(tmp_path.iterdir())) == 2
    names = ("corner_masks", "corner_depths")
    batch = read_batch(more, [2, 0], [[0, 1], [1, 0]], extras=names)
    assert batch["corner_masks"].shape == batch["corner_depths"].shape == (2, 8, 16, 16)
    np.testing.assert_array_equal(batch["corner_masks"][1], more.corner_masks[0])
    covered = batch["corner_masks"] > 0
    assert covered.any(axis=(2, 3)).all()
    assert (np.abs(batch["corner_depths"][covered] - 2) < 0.5).all()
    assert "corner_masks" not in read_batch(plain, [0], [[0]], extras=names)
