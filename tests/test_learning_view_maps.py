"""EPCG: fusion of maps against known geometry, pseudo-renders against an oracle."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from tiny_runs import (
    make_recipe,
    random_quaternions,
    rotation_matrix,
    tiny_config,
)

from dpc_jax.config import replace_fields
from dpc_jax.data import DataSpec, load_or_render
from dpc_jax.data.batches import read_batch
from dpc_jax.data.viewpoints import CORNERS, look_at_rotation, matrix_to_quaternion
from dpc_jax.data.views import Lights, build_scene, render_view
from dpc_jax.learning.shapes import view_maps
from dpc_jax.learning.shapes.kind import View
from dpc_jax.learning.shapes.view_maps import ViewMaps
from dpc_jax.learning.signals import Weights
from dpc_jax.networks.view_maps import fuse_maps, list_fixed_views, make_planes
from dpc_jax.render import Camera

CAMERA = Camera()
IDENTITY = jnp.array([1.0, 0.0, 0.0, 0.0])
BOTH = Weights(depth=1.0)


def maps_config(**fields):
    base = tiny_config(source="given", depth_weight=1.0, **fields)
    changes = {"network": {"shape": "maps"}}
    return replace_fields(base, changes | {"render": {"fixed_views_until": 0.5}})


def place(u, v, z):
    """The point of the object frame, seen with the identity, at (u, v) and depth z."""
    focal = CAMERA.focal_length
    return [u * z / focal, v * z / focal, z - CAMERA.distance]


def draw(points, logits, *, side=4, rotation=IDENTITY):
    return view_maps.pseudo_render(
        jnp.asarray(points, jnp.float32),
        jnp.asarray(logits, jnp.float32),
        View(rotation, CAMERA, side),
    )


def compare(points, logits, targets, weights, side=4):
    scene = {"points": jnp.asarray(points, jnp.float32)}
    scene["point_logits"] = jnp.asarray(logits, jnp.float32)
    view = View(IDENTITY, CAMERA, side)
    return ViewMaps.compare_view(scene, view, targets, weights=weights)


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
    recipe = make_recipe(maps_config())

    @jax.jit
    def compare(maps, logits):
        shapes = ViewMaps(maps, points, logits)
        return view_maps.compare_fixed_views(shapes, batch, recipe=recipe)

    _, terms = compare(maps, logits)
    assert float(terms["pixel_deviation"]) == pytest.approx(0, abs=1e-6)
    # Only pixels of the rim, half covered, whose depth was left at the plane.
    rim = np.sum((masks < 255) & (masks >= 128)) / 8
    assert float(terms["depth"]) < 0.3 * rim + 1e-4
    worse, _ = compare(maps.at[..., 2].add(0.1), logits)
    assert float(worse) > float(compare(maps, logits)[0]) + 10
    shifted = compare(maps.at[..., 0].add(0.01), logits)[1]
    assert float(shifted["pixel_deviation"]) == pytest.approx(0.01 * 32**2, rel=1e-4)


def test_fused_maps_drawn_in_each_fixed_view_are_the_maps_again(corners):
    maps, logits = true_maps(corners)
    points = fuse_maps(maps, focal_length=1.875, distance=2.0)[0]
    rotations = jnp.asarray(matrix_to_quaternion(list_fixed_views()), jnp.float32)
    seen = corners[0] == 255
    # Of each view its own points alone: others may be nearer in the same pixel.
    own = jnp.where(jnp.eye(8)[..., None] > 0, logits.reshape(8, -1), -9)
    drawn = jax.jit(jax.vmap(lambda q, own: draw(points, own, side=32, rotation=q)))(
        rotations, own.reshape(8, -1)
    )
    np.testing.assert_array_equal(drawn.logits > 0, seen)
    np.testing.assert_array_equal(np.asarray(drawn.counts)[seen], 1)
    # float32 through two rotations.
    np.testing.assert_allclose(
        np.asarray(drawn.depths)[seen], maps[0, ..., 2][seen], atol=1e-5
    )


def test_of_two_points_in_a_pixel_the_nearer_one_is_seen_and_alone_learns():
    # Cells are a twentieth wide: 0.01 and 0.06 are neighbours in one pixel.
    def read(depths):
        points = jnp.stack(
            [
                jnp.stack(place(0.01, 0.01, depths[0])),
                jnp.stack(place(0.06, 0.01, depths[1])),
            ]
        )
        return draw(points, [1.0, 2.0])

    depths = jnp.array([0.8, 1.2])
    seen = read(depths)
    assert float(seen.depths[2, 2]) == pytest.approx(0.8, rel=1e-6)
    assert float(seen.logits[2, 2]) == 2.0 and float(seen.counts[2, 2]) == 1
    assert float(jnp.sum(seen.counts)) == 1
    slope = jax.grad(lambda z: read(z).depths[2, 2])(depths)
    np.testing.assert_allclose(slope, [1, 0], atol=1e-5)


def test_two_points_in_one_cell_are_not_compared():
    points = [place(0.01, 0.01, 1.0), place(0.02, 0.02, 1.0)]
    whole = jnp.ones((4, 4))
    targets = {"silhouette": whole, "depth": 2 * whole, "measured": whole}
    for count, cost in ((2, 0), (1, 1)):
        terms = compare(points[:count], [1.0] * count, targets, BOTH)[1]
        assert float(terms["depth"]) == pytest.approx(cost)


def test_masks_alone_teach_no_coordinate():
    rng = np.random.default_rng(0)
    points = jnp.asarray(rng.uniform(-0.4, 0.4, (40, 3)), jnp.float32)
    logits = jnp.asarray(rng.normal(size=40), jnp.float32)
    targets = {"silhouette": jnp.asarray(rng.uniform(size=(4, 4)), jnp.float32)}

    def measure(points, logits):
        return compare(points, logits, targets, Weights())[0]

    by_points, by_logits = jax.grad(measure, (0, 1))(points, logits)
    assert not np.any(by_points) and np.any(by_logits)


def draw_plainly(points, logits, rotation, side):
    """The same in float64, point by point."""
    size = side * view_maps.FINER
    fine = np.zeros((size, size, 4))
    for point, logit in zip(points, logits, strict=True):
        x, y, z = rotation_matrix(rotation) @ point
        z += 2
        column = int(np.floor((1.875 * x / z + 0.5) * size))
        row = int(np.floor((1.875 * y / z + 0.5) * size))
        if z <= 0.1 or not (0 <= column < size and 0 <= row < size):
            continue
        if logit > 0:
            fine[row, column, :3] += [1 / z, logit, 1]
        else:
            fine[row, column, 3] += logit
    found = np.zeros((3, side, side))
    for i, j in np.ndindex(side, side):
        block = fine[5 * i : 5 * i + 5, 5 * j : 5 * j + 5].reshape(25, 4)
        nearest, top, count = block[:, :3].max(axis=0)
        hidden = block[:, 3].mean()
        logit = top if top > 0 else hidden if hidden < 0 else -1
        found[:, i, j] = logit, 1 / nearest if nearest else 1, count
    return found


@pytest.mark.parametrize("seed", range(2))
def test_a_cloud_is_drawn_as_by_hand_and_nothing_outside_comes_back_in(seed):
    rng = np.random.default_rng(seed)
    # Half a dozen of them beside the image, and some behind the camera.
    points = rng.uniform(-0.6, 0.6, (60, 3))
    points[:5, 2] -= 2.5
    logits = rng.normal(size=60)
    rotation = random_quaternions(seed, 1)[0] if seed else np.eye(4)[0]
    seen = draw(points, logits, side=6, rotation=jnp.asarray(rotation, jnp.float32))
    expected = draw_plainly(points, logits, rotation, 6)
    for one, other in zip(seen, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)  # float32


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
