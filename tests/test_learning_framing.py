"""What the network sees of a view: image and mask, framed where distance is unknown."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tiny_runs import (
    make_batch,
    make_dataset,
    make_network,
    make_state,
    make_step,
    tiny_config,
)

from dpc_jax.data import DataSpec
from dpc_jax.data.sets import framing as photographs
from dpc_jax.data.sets.photographs import Photographs
from dpc_jax.learning import framing, objective
from dpc_jax.learning.framing import make_inputs
from dpc_jax.learning.inference.predictor import make_predictor, predict_all
from dpc_jax.learning.step import describe_state
from dpc_jax.run.prediction.objects import place_photographs

SIDE = 64


def draw_shape(*, middle=(0.0, 0.0), size=1.0, side=SIDE):
    """A lopsided silhouette [side, side], 0 to 1: two ellipses, smooth at the rim."""
    places = (np.arange(side) + 0.5) / side - 0.5
    v, u = (places[:, None] - middle[0]) / size, (places[None] - middle[1]) / size
    inside = np.minimum(
        (u / 0.3) ** 2 + (v / 0.12) ** 2, ((u - 0.2) / 0.1) ** 2 + (v / 0.25) ** 2
    )
    return np.clip((1 - inside) * 0.15 * side * size + 0.5, 0, 1)


@pytest.mark.parametrize(("middle", "size"), [((0.1, -0.2), 0.6), ((0, 0), 1.3)])
def test_a_box_is_framed_as_photographs_are_cut_out(middle, size):
    mask = np.uint8(255 * draw_shape(middle=middle, size=size))
    image = np.where(mask[..., None] > 0, np.uint8([30, 90, 200]), np.uint8(255))
    network = make_network(tiny_config(sees_mask=True))
    inputs = make_inputs(image, mask, network=network, is_framed=True)
    outline = photographs.trace_outline(mask > 127)
    spec = DataSpec("car", kind="images", folder=".", crop="view", image_size=SIDE)
    frames = photographs.frame_views([outline], None, spec)
    cut = photographs.cut_frames([(image, mask / np.float32(255))], frames, spec)
    expected = np.concatenate([cut["images"][0], cut["masks"][0][..., None]], axis=-1)
    # The other one integrates over pixels: only the rim differs, by parts of a pixel.
    assert np.abs((inputs + 1) * 127.5 - expected).mean() < 3


def test_beyond_the_image_is_white_and_no_object():
    mask = np.zeros((SIDE, SIDE), np.uint8)
    mask[:, :4] = 255  # its frame reaches far beyond the left edge
    image = np.full((SIDE, SIDE, 3), 0, np.uint8)
    network = make_network(tiny_config(sees_mask=True))
    inputs = make_inputs(image, mask, network=network, is_framed=True)
    np.testing.assert_allclose(
        inputs[:, :20],
        jnp.broadcast_to(jnp.array([1.0, 1, 1, -1]), (SIDE, 20, 4)),
        atol=1e-6,
    )


def test_views_that_are_not_framed_stay_as_they_are():
    masks = np.stack([np.uint8(255 * draw_shape(size=s)) for s in (0.5, 0.7)])
    images = np.random.default_rng(0).integers(0, 256, (2, SIDE, SIDE, 3), np.uint8)
    network = make_network(tiny_config(sees_mask=True))
    plain = make_inputs(images, masks, network=network)
    mixed = make_inputs(images, masks, network=network, is_framed=np.array([0, 1]) > 0)
    np.testing.assert_allclose(mixed[0], plain[0], atol=1e-6)
    assert np.abs(mixed[1] - plain[1]).max() > 0.5


@pytest.mark.parametrize(("middle", "size"), [((0.08, -0.12), 0.7), ((-0.1, 0), 0.5)])
def test_silhouettes_of_all_sizes_and_places_are_alike_in_their_frames(middle, size):
    def cut(silhouette):
        return framing.cut_silhouettes(silhouette, framing.frame_by_moments(silhouette))

    one, other = draw_shape(), draw_shape(middle=middle, size=size)
    assert np.mean((one - other) ** 2) > 0.03
    # A rim of one pixel is two wide where the shape is half as large.
    assert np.mean((cut(one) - cut(other)) ** 2) < 0.008


@pytest.mark.parametrize(
    ("middle", "size"), [((0.012, 0.0), 1.0), ((0.0, -0.03), 1.0), ((0, 0), 1.1)]
)
def test_a_frame_is_fitted_where_moments_are_pixels_off(middle, size):
    given, seen = draw_shape(), draw_shape(middle=middle, size=size)
    start = framing.Frame(jnp.zeros(2), jnp.ones(()))
    found = framing.fit_frame(start, seen, given)
    # A third of a pixel of 64, and a fifth of the size: the first order leaves these.
    np.testing.assert_allclose(found.centre, middle, atol=0.005)
    assert abs(float(found.side) - size) < 0.02
    left = np.sum((framing.cut_silhouettes(seen, found) - given) ** 2)
    assert left < 0.2 * np.sum((seen - given) ** 2)


def test_what_shows_nothing_has_a_frame():
    nothing = np.zeros((2, SIDE, SIDE), np.uint8)
    by_box, by_moments = framing.frame_by_box, framing.frame_by_moments
    for frame in (by_box(nothing), by_moments(nothing / 255)):
        assert np.isfinite(frame.centre).all() and (np.asarray(frame.side) > 0).all()
        assert not np.asarray(framing.cut_silhouettes(nothing / 255, frame)).any()
    start = framing.frame_by_moments(nothing[0] / 255)
    for silhouettes in (nothing / 255, (draw_shape(), nothing[0] / 255)):
        found = framing.fit_frame(start, *silhouettes)
        assert np.isfinite(found.centre).all() and found.side > 0


def test_photographs_come_to_the_place_and_size_of_what_is_predicted():
    given = np.uint8(255 * draw_shape(middle=(0.1, 0.1), size=0.6))
    image = np.where(given[..., None] > 127, np.uint8(40), np.uint8(255))
    image = np.repeat(image, 3, axis=-1)
    one = Photographs("a", ("a.png",), image[None], given[None], given[None], ())
    wanted = draw_shape(middle=(-0.05, 0.0), size=0.9, side=32)
    (placed,) = place_photographs([one], wanted[None])
    expected = draw_shape(middle=(-0.05, 0.0), size=0.9)
    assert np.mean((placed.masks[0] / 255 - expected) ** 2) < 0.003
    is_dark = placed.images[0, ..., 0] < 150
    assert np.mean(is_dark != (expected > 0.5)) < 0.01


def test_pixels_that_shrink_are_means():
    """Stripes of one pixel are grey from three times as far."""
    stripes = np.zeros((SIDE, SIDE))
    stripes[:, ::2] = 1
    small = framing.cut_silhouettes(stripes, framing.Frame(jnp.zeros(2), jnp.array(3)))
    # A tent of weights 1 to 3 over five of them: 4/9 or 5/9. The image is the middle
    # third now.
    assert (np.abs(small[26:38, 26:38] - 0.5) < 0.06).all()
    assert not np.asarray(small[:20]).any()


@pytest.mark.parametrize("knows_distance", [True, False])
def test_a_photograph_means_the_same_wherever_its_object_is(knows_distance):
    config = tiny_config(framed_views=True, sees_mask=True)
    network = make_network(config)
    state = make_state(network, config)
    dataset = make_dataset(models=2, views=2)
    masks = np.zeros((2, 2, 16, 16), np.uint8)
    masks[..., 5:10, 4:12] = 255
    rng = np.random.default_rng(0)
    colors = rng.integers(0, 200, (*masks.shape, 3), np.uint8)
    images = np.where(masks[..., None] > 0, colors, np.uint8(255))
    predictor = make_predictor(network, config, knows_distance=knows_distance)

    def predict(shift):
        moved = {
            "images": np.roll(images, shift, axis=(2, 3)),
            "masks": np.roll(masks, shift, axis=(2, 3)),
        }
        return predict_all(predictor, state, dataset._replace(**moved)).points

    away = np.abs(predict((3, -2)) - predict((0, 0))).max()
    assert away > 1e-3 if knows_distance else away < 1e-5


def test_training_sees_framed_views_where_they_are_asked_for(monkeypatch):
    seen = []

    def record(*arguments, is_framed, **options):
        seen.append(is_framed)
        return make_inputs(*arguments, is_framed=is_framed, **options)

    monkeypatch.setattr(objective, "make_inputs", record)
    for asked in (False, True):
        config = tiny_config(source="given", sees_mask=True, framed_views=asked)
        network = make_network(config)
        state = describe_state(network, config)
        jax.eval_shape(make_step(network, config), state, make_batch())
    assert seen[0] is False and seen[-1].shape == (4,)
