"""One frame for a category: objects that fit it better turned are turned back."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from data_trees import project_points
from scipy import ndimage
from tiny_runs import assert_same_bits, tiny_config

from dpc_jax import rotation_angle_deg
from dpc_jax.learning.candidates import (
    average_covariance,
    find_half_turns,
    turn_candidates,
)
from dpc_jax.learning.choice import colors, common_frame
from dpc_jax.learning.choice.hindsight import Winners
from dpc_jax.learning.devices import AXIS
from dpc_jax.learning.inference.explanation import (
    find_color_scores,
    observe,
    weigh_by_colors,
)
from dpc_jax.render import Camera, quaternion

COVARIANCE = jnp.diag(jnp.array([1.0, 2.0, 4.0]))  # the axes are x, y and z
HEADS, SIDE = 2, 32
COUNT, VIEWS = 4, 3  # of every batch, so that few programs are compiled
BY_COLORS = tiny_config(common_frame="colors")
YELLOW, RED, GREY = (240, 220, 40), (220, 30, 30), (128, 128, 128)


def draw_bar(rng, *, thick):
    """A bar along z; thick at its lower end, or the same all along."""
    points = rng.uniform(-1, 1, (400, 3)) * [0.05, 0.1, 0.4]
    if thick:
        points[:150, :2] *= 2.5
        points[:150, 2] = -np.abs(points[:150, 2])
    return jnp.asarray(points, jnp.float32)


def draw_views(points, poses, ends, **camera):
    """Images of points, one half in one colour and the other in another one."""
    images = np.full((len(poses), SIDE, SIDE, 3), 255, np.uint8)
    masks = np.zeros((len(poses), SIDE, SIDE), np.uint8)
    for view, pose in enumerate(poses):
        *places, ahead = project_points(points, pose, SIDE, **camera)
        rows, columns = np.clip(np.array(places).astype(int), 0, SIDE - 1)
        for kind, color in enumerate(ends):
            these = (np.asarray(points[:, 2]) > 0) == bool(kind)
            order = np.argsort(-ahead[these])
            images[view, rows[these][order], columns[these][order]] = color
        masks[view, rows, columns] = 255
    return jnp.asarray(images), jnp.asarray(masks)


@jax.jit
def turn(winners, points, images, masks, frame, is_due):
    """`turn_back` on devices with an object each: a shape for all views, or of each."""
    how = {"heads": HEADS, "is_due": is_due}

    def on_device(winners, points, images, masks):
        numbers = jax.lax.axis_index(AXIS) * VIEWS + jnp.arange(VIEWS)
        batch = {"images": images, "masks": masks, "view_ids": numbers}
        points = jnp.broadcast_to(points, (VIEWS, *points.shape[-2:]))
        seen = winners, points, batch, find_half_turns(COVARIANCE), frame
        if isinstance(frame, common_frame.Frame):
            known = {"covariance": COVARIANCE, "views": VIEWS}
            return common_frame.turn_back(*seen, **known, **how)
        return colors.turn_views(*seen, camera=Camera(), cameras={}, **how)

    new, frames, shares = jax.vmap(on_device, axis_name=AXIS)(
        winners, points, images, masks
    )
    frame = jax.tree.map(lambda a: a[0], frames)  # all devices have the same
    new = new._replace(losses=winners.losses)
    return new, frame, jnp.mean(shares)


def make_objects(count=COUNT, *, thick, ends, seed=0):
    """Objects in one frame, seen from anywhere; winners are the true poses."""
    rng = np.random.default_rng(seed)
    points, images, masks, poses = [], [], [], []
    for _ in range(count):
        points.append(draw_bar(rng, thick=thick))
        drawn = rng.normal(size=(3, 4))
        drawn /= np.linalg.norm(drawn, axis=1, keepdims=True)
        poses.append(jnp.asarray(drawn, jnp.float32))
        drawn = draw_views(points[-1], poses[-1], ends)
        images.append(drawn[0]), masks.append(drawn[1])
    turns = jnp.zeros((count, 3), jnp.int32)  # of head 1 of 2, not turned
    # No other candidate was compared.
    losses = jnp.full((count, 3, 4 * HEADS), jnp.inf).at[:, :, 1].set(0)
    winners = Winners(jnp.stack(poses), turns + 1, losses)
    return winners, *map(jnp.stack, (points, images, masks))


@functools.cache
def learn_frame(*, by_colors=False, **kind):
    frame = colors.start_counts() if by_colors else common_frame.start_frame()
    for seed in range(24 // COUNT):
        _, frame, share = turn(*make_objects(**kind, seed=seed), frame, False)
        assert not share
    return frame


def learn_ends():
    """The frame of bars with ends of two colours, and a batch of others."""
    frame = learn_frame(by_colors=True, thick=False, ends=(YELLOW, RED))
    # Kept sums are those of some 24 objects; a run has seen hundreds.
    return frame * 30, *make_objects(thick=False, ends=(YELLOW, RED), seed=9)


def learn_bars(seed=9):
    """The frame of bars with a thick end, and a batch of others."""
    frame = learn_frame(thick=True, ends=(GREY, GREY))
    return frame, make_objects(thick=True, ends=(GREY, GREY), seed=seed)


def multiply(poses, turn):
    """Poses [..., 4] after one turn of the object."""
    flat = jax.vmap(quaternion.multiply, (0, None))(poses.reshape(-1, 4), turn)
    return flat.reshape(poses.shape)


def exchange_ends(winners, points, images, masks):
    """The same views of shapes that were learned upside down, about the axis y."""
    about_y = jnp.array([0.0, 0, 1, 0])
    poses = multiply(winners.poses, about_y)
    turned = jax.vmap(quaternion.rotate, (0, None))(points, about_y)
    return winners._replace(poses=poses), turned, images, masks


def test_a_shape_that_fits_the_category_better_turned_is_turned_back():
    frame, right = learn_bars()
    kept, _, share = turn(*right, frame, True)
    assert float(share) == 0
    assert_same_bits(kept, right[0])
    wrong = exchange_ends(*right)
    early, _, share = turn(*wrong, frame, False)  # not due yet
    assert float(share) == 0
    assert_same_bits(early, wrong[0])
    found, _, share = turn(*wrong, frame, True)
    assert float(share) == 1
    # As silhouettes see it: the turned shape from the new poses is the old one.
    up = jnp.array([0.0, 0, 0, 1])  # the bar is as thick in x as in y: either axis
    poses = jnp.stack([found.poses, multiply(found.poses, up)])
    assert np.all(rotation_angle_deg(poses, right[0].poses).min(axis=0) < 0.5)


def test_a_turned_object_is_held_there_until_its_shape_fits():
    frame, right = learn_bars()
    wrong = exchange_ends(*right)
    decided, after, _ = turn(*wrong, frame, True)
    after = frame._replace(decisions=after.decisions)
    half = [points[:, ::2] for points in (right[1], wrong[1])]
    # Half way round, it fits both ways alike.
    both = jnp.stack(half, axis=2).reshape(COUNT, -1, 3)
    is_first = (jnp.arange(VIEWS) == 0)[None, :, None]
    poses = jnp.where(is_first, wrong[0].poses, decided.poses)
    mixed = wrong[0]._replace(poses=poses)
    for views in (wrong[0], mixed, decided):
        left, _, _ = turn(views, both, *right[2:], frame, True)
        assert_same_bits(left.poses, views.poses)  # of one that was never turned
        held, _, _ = turn(views, both, *right[2:], after, True)
        assert np.all(rotation_angle_deg(held.poses, decided.poses) < 0.5)
    # Then its views are free, also one that finds the other way.
    free, _, share = turn(mixed, *right[1:], after, True)
    assert float(share) == 0
    assert_same_bits(free.poses, mixed.poses)


def test_the_shapes_of_all_views_of_an_object_decide_together():
    """Two of three are predicted upside down, or one."""
    frame, right = learn_bars()
    wrong = exchange_ends(*right)
    for count in (1, 2):
        is_wrong = (jnp.arange(VIEWS) < count)[None, :, None, None]
        points = jnp.where(is_wrong, wrong[1][:, None], right[1][:, None])
        found, _, share = turn(right[0], points, *right[2:], frame, True)
        assert float(share) == (count == 2)
        turned = np.any(np.asarray(found.indices) != right[0].indices, axis=1)
        assert np.all(turned == (count == 2))


def test_the_winner_is_the_same_head_after_that_half_turn():
    frame, right = learn_bars(seed=4)
    wrong = exchange_ends(*right)
    turns = find_half_turns(COVARIANCE)
    for before in range(4):  # the half turn that the view had
        heads = wrong[0].poses.reshape(3 * COUNT, 1, 4)
        both = jnp.concatenate([heads[:, :, ::-1], heads], axis=1)  # K = 2, the second
        candidates = jax.vmap(turn_candidates, (0, None))(both, turns)
        index = before * HEADS + 1
        poses = candidates[:, index].reshape(COUNT, 3, 4)
        undone = jax.vmap(quaternion.rotate, (0, None))(wrong[1], turns[before])
        winners = wrong[0]._replace(poses=poses, indices=jnp.full((COUNT, 3), index))
        found, _, share = turn(winners, undone, *wrong[2:], frame, True)
        chosen = jax.vmap(lambda q, i: q[i])(candidates, found.indices.reshape(-1))
        same = rotation_angle_deg(chosen, found.poses.reshape(-1, 4))
        assert np.all(same < 0.05)
        if before == 0:
            assert float(share) == 1
            assert np.all(np.asarray(found.indices) % HEADS == 1)


def test_colors_turn_a_view_that_silhouettes_leave_open():
    """The first view of each object is learned from the wrong end."""
    frame, right, *seen = learn_ends()
    about_y, partner = 2, 2 * HEADS + 1
    wrong = multiply(right.poses[:, 0], find_half_turns(COVARIANCE)[about_y])
    for loss, is_turned in ((0.0, True), (1e3, False)):
        winners = Winners(
            right.poses.at[:, 0].set(wrong),
            right.indices.at[:, 0].set(partner),
            right.losses.at[:, 0, partner].set(0).at[:, 0, 1].set(loss),
        )
        early, *_ = turn(winners, *seen, frame, False)
        assert_same_bits(early, winners)
        found, _, share = turn(winners, *seen, frame, True)
        assert np.isclose(share, is_turned / VIEWS)
        expected = right if is_turned else winners
        np.testing.assert_array_equal(found.indices, expected.indices)
        assert np.all(rotation_angle_deg(found.poses, expected.poses) < 0.5)


@pytest.mark.parametrize("distance", [2.0, 3.0])
def test_colors_say_from_which_end_an_image_is_taken(distance):
    """Also of a photograph, whose distance is not known."""
    frame, winners, points, *_ = learn_ends()
    scores = find_color_scores(frame, BY_COLORS)
    cloud, true = points[0], winners.poses[0, 0]
    away = distance != 2.0
    image, mask = draw_views(cloud, true[None], (YELLOW, RED), distance=distance)
    base = observe(mask, {}, 32, config=tiny_config(), knows_distance=not away)
    base = jax.tree.map(lambda a: a[0], base)
    candidates = jnp.stack(
        [quaternion.multiply(true, find_half_turns(COVARIANCE)[2]), true]
    )

    @jax.jit
    def weigh(scores):
        view = {"points": cloud}, candidates, image[0], mask[0], base
        given = jnp.array([0.6, 0.4])  # by the student
        return weigh_by_colors(given, *view, scores=scores, config=tiny_config())

    np.testing.assert_allclose(weigh(jnp.zeros_like(scores)), [0.6, 0.4], rtol=1e-6)
    assert weigh(scores)[1] > 0.9
    assert not np.any(find_color_scores(colors.start_counts(), BY_COLORS))


def draw_plane(rng, *, wing, tail):
    """A body along z with a wing and a shorter tail across it, at these heights."""
    parts = ((160, 0, 0.03, 0.4), (160, wing, 0.3, 0.05), (80, tail, 0.12, 0.04))
    points = [
        rng.uniform(-1, 1, (n, 3)) * [0.03, half, depth] + [0, 0, place]
        for n, place, half, depth in parts
    ]
    return jnp.asarray(np.concatenate(points), jnp.float32)


def remember(clouds):
    """Shapes and their number, as a frame has them."""
    shapes = jax.vmap(common_frame.count_points)(jnp.stack(clouds))
    room = common_frame.OBJECTS - len(clouds)
    return jnp.pad(shapes, ((0, room), (0, 0))), jnp.array(len(clouds))


def compare_ends(remembered, points):
    """What points gain by the half turns that exchange the ends of a plane."""
    turns = find_half_turns(COVARIANCE)
    ways = common_frame.list_ways(COVARIANCE, is_upright=False)
    scores = common_frame.judge_cells(points, *remembered)
    fits = common_frame.compare_places(points, turns, ways, scores)
    return np.asarray(fits[1:3] - fits[0])


ABOUT_X = jnp.array([[1.0, -1, -1]])


def test_a_kind_fits_the_category_wherever_in_its_box_its_parts_are(monkeypatch):
    """A wing farther in front is where others have theirs if all is turned round.

    The tail is not then. Moved to where both fit, the kind is seen to be turned.
    """
    rng = np.random.default_rng(0)
    usual = remember([draw_plane(rng, wing=-0.1, tail=-0.38) for _ in range(30)])
    right = draw_plane(rng, wing=0.1, tail=-0.18)
    assert compare_ends(usual, right).max() < 0
    assert compare_ends(usual, right * ABOUT_X).max() > 0
    nothing = jnp.zeros_like(usual[0]), jnp.array(0)
    assert not compare_ends(nothing, right).any()
    monkeypatch.setattr(common_frame, "_SHIFTS", (0.0,))
    assert compare_ends(usual, right * ABOUT_X).max() < 0


def test_a_kind_that_is_turned_round_does_not_judge_itself(monkeypatch):
    rng = np.random.default_rng(0)
    usual = [draw_plane(rng, wing=-0.1, tail=-0.38) for _ in range(40)]
    kind = [draw_plane(rng, wing=0.1, tail=-0.18) * ABOUT_X for _ in range(8)]
    assert compare_ends(remember(usual + kind), kind[0]).max() > 0
    # As many as its own are left out; with more of them, it agrees with itself.
    monkeypatch.setattr(common_frame, "_ALIKE", 0.0)
    assert compare_ends(remember(usual + 4 * kind), kind[0]).max() < 0


def test_the_last_objects_are_remembered(monkeypatch):
    monkeypatch.setattr(common_frame, "OBJECTS", 10)
    frame = common_frame.start_frame()
    clouds = []
    for seed in range(3):
        objects = make_objects(thick=True, ends=(GREY, GREY), seed=seed)
        clouds.append(jax.vmap(common_frame.count_points)(objects[1]))
        _, frame, _ = turn(*objects, frame, False)
    counted = jnp.concatenate(clouds)
    assert int(frame.count) == len(counted) == 12
    # Object i is in row i, and the last 2 begin anew.
    assert_same_bits(frame.shapes[:2], counted[10:])
    assert_same_bits(frame.shapes[2:], counted[2:10])


def test_ways_are_level_where_cameras_are_upright():
    covariance = jnp.array([[3.0, 1, 0.5], [1, 2, 0.1], [0.5, 0.1, 9]])
    ways = np.asarray(common_frame.list_ways(covariance, is_upright=True))
    assert ways.shape == (2, 3)
    np.testing.assert_array_equal(ways[:, 2], 0)
    # float32, of products of numbers of size one
    np.testing.assert_allclose(ways @ ways.T, np.eye(2), atol=1e-6)
    assert abs(ways[0] @ np.asarray(covariance) @ ways[1]) < 1e-5


@pytest.mark.parametrize(
    ("gains", "mean", "turns", "fit"),
    [
        ([[0.02], [-0.08]], -0.06, [1, 0], [False, True]),
        ([[0.01], [-0.02]], -0.06, [0, 0], [False, False]),  # both ways alike
        ([[0.02], [-0.08]], -0.01, [0, 0], [True, True]),  # tells nothing apart
    ],
)
def test_points_decide_where_they_tell_the_category_from_its_half_turn(
    gains, mean, turns, fit
):
    moments = jnp.array([[1.0], [mean], [0.0052]])
    wanted, fits = common_frame._choose_turns(jnp.array(gains), moments)
    assert wanted.tolist() == turns
    assert fits.tolist() == fit


def test_a_color_has_the_same_bin_however_dark_it_is():
    color = np.array([0.8, 0.5, 0.1])
    grey = np.array([0.5, 0.5, 0.5])
    shades = [color, 0.7 * color, grey, 0.1 * grey, 2 * grey]
    bright, dark, *greys = np.asarray(colors.sort_colors(jnp.asarray(shades)))
    assert bright == dark
    assert len(set(greys)) == 1 and greys[0] != bright


def draw_tiles(rng):
    """An image of 64 evenly coloured squares, greys among them; numbers from 0 to 1."""
    tiles = rng.uniform(0.1, 0.9, (8, 8, 3))
    tiles[::2, ::2] = tiles[::2, ::2, :1]
    return np.kron(tiles, np.ones((8, 8, 1)))


def to_bytes(image):
    return jnp.asarray(np.clip(np.rint(255 * image), 0, 255), jnp.uint8)


def test_without_noise_a_color_is_of_its_bin_alone():
    image = to_bytes(draw_tiles(np.random.default_rng(0)))
    shares = np.asarray(colors.spread_colors(image, jnp.full((64, 64), 255, jnp.uint8)))
    bins = np.asarray(colors.sort_colors(image / 255))
    own = np.take_along_axis(shares, bins[..., None], axis=-1)
    assert np.all(own > 1 - 1e-6)  # float32
    # Too small to measure noise in.
    empty = colors.spread_colors(image, jnp.zeros((64, 64), jnp.uint8))
    np.testing.assert_array_equal(empty, shares)


def test_a_blurred_image_comes_nearer_to_the_sharp_one_and_others_stay():
    sharp, inside = draw_tiles(np.random.default_rng(1)), jnp.ones((64, 64), bool)
    blurred = ndimage.gaussian_filter(sharp, (1, 1, 0))
    found = colors._sharpen(jnp.asarray(blurred, jnp.float32), inside)
    # To first order: 0.89 of the error are left.
    assert np.std(found - sharp) < 0.92 * np.std(blurred - sharp)
    plain = np.full((64, 64, 3), 0.3)
    for image in (sharp, plain):
        given = jnp.asarray(image, jnp.float32)
        np.testing.assert_array_equal(colors._sharpen(given, inside), given)


def test_a_noisy_color_is_of_the_bins_that_such_noise_leads_to():
    """Against the frequencies of draws from the same noise."""
    rng, noise = np.random.default_rng(0), 0.04
    seen = draw_tiles(rng) + rng.normal(0, noise, (64, 64, 3))
    mask = jnp.full((64, 64), 255, jnp.uint8)
    shares = np.asarray(colors.spread_colors(to_bytes(seen), mask))
    np.testing.assert_allclose(shares.sum(-1), 1, rtol=1e-5)
    for place in ((2, 2), (20, 20), (20, 29), (60, 3)):
        drawn = seen[place] + rng.normal(0, noise, (4000, 3))
        bins = np.asarray(colors.sort_colors(jnp.asarray(drawn)))
        wanted = np.bincount(bins, minlength=colors.BINS**2) / len(bins)
        # Brightness is taken as it is seen, and the axes as independent: together
        # within a tenth.
        assert np.abs(shares[place] - wanted).sum() / 2 < 0.1


def test_points_behind_others_have_no_color():
    """A wall in front of another one, seen along z."""
    grid = np.stack(np.meshgrid(*[np.linspace(-0.2, 0.2, 20)] * 2), -1).reshape(-1, 2)
    walls = [np.c_[grid, np.full(len(grid), z)] for z in (-0.2, 0.2)]
    points = jnp.asarray(np.concatenate(walls), jnp.float32)
    own = {"rotation": jnp.array([1.0, 0, 0, 0])}
    bins = jnp.zeros((SIDE, SIDE), jnp.int32)
    mask = jnp.full((SIDE, SIDE), 255, jnp.uint8)
    see = jax.jit(functools.partial(colors.see_points, camera=Camera()))
    samples = see(points, own, bins, mask)
    near, far = np.asarray(samples.weights).reshape(2, -1)
    assert np.all(near > 0)
    assert np.mean(far > 0) < 0.1  # none but at the border of the near one


def test_the_covariance_is_a_mean_of_all_batches_and_later_of_the_last_hundred():
    batches = np.random.default_rng(0).normal(size=(60, 3, 3))
    average = jnp.zeros((3, 3))
    for step, batch in enumerate(batches):
        average = average_covariance(average, jnp.asarray(batch), step)
    np.testing.assert_allclose(average, batches.mean(0), atol=1e-6)
    moved = average_covariance(jnp.zeros(()), jnp.ones(()), 10_000)
    np.testing.assert_allclose(moved, 0.01, rtol=1e-6)
