"""Random colours of objects: white, silhouettes and views of one object stay alike."""

import jax
import numpy as np
import pytest
from tiny_runs import make_batch, make_network, make_state, make_step, tiny_config

from dpc_jax.learning.recoloring import recolor_images

RNG = np.random.default_rng(0)


def keys(count, seed=0):
    return jax.random.split(jax.random.key(seed), count)


def test_white_stays_white_and_nothing_else_does():
    images = RNG.integers(0, 200, (3, 2, 8, 8, 3)).astype(np.uint8)
    images[:, :, :4] = 255
    made = np.asarray(recolor_images(images, keys(3)))
    assert made.dtype == np.uint8 and made.shape == images.shape
    assert (made[:, :, :4] == 255).all()
    assert (made[:, :, 4:] < 255).any(axis=-1).all()


def test_equal_colors_stay_equal_in_all_views_and_differ_between_objects():
    colors = RNG.integers(0, 256, (5, 3)).astype(np.uint8)
    images = colors[RNG.integers(0, 5, (4, 3, 8, 8))]
    made = np.asarray(recolor_images(images, keys(4)))
    palettes = set()
    for one, new in zip(images, made, strict=True):
        found = [np.unique(new[(one == color).all(-1)], axis=0) for color in colors]
        assert all(len(colors) == 1 for colors in found)
        palettes.add(np.concatenate(found).tobytes())
    assert len(palettes) == 4


def test_hues_come_out_all_round():
    """Of 300 draws for one red object each channel is the darkest in a fifth."""
    red = np.full((300, 1, 1, 1, 3), (200, 30, 30), np.uint8)
    made = np.asarray(recolor_images(red, keys(300)))[:, 0, 0, 0]
    shares = np.bincount(made.argmin(axis=1), minlength=3) / 300
    assert shares.min() > 0.2 and np.ptp(made.mean(axis=1)) > 50


def test_a_training_step_encodes_the_new_colors_with_the_keys_of_its_objects(
    quickly,
):
    """Poses are known and masks compared: images matter to nothing but the encoder."""
    losses, batch = [], make_batch()
    key = jax.random.fold_in(jax.random.key(0), 0)
    painted = recolor_images(batch["images"], jax.random.split(key, 2))
    for is_asked, images in ((True, batch["images"]), (False, painted)):
        config = tiny_config(recolor=is_asked, known=True)
        network = make_network(config)
        step, state = make_step(network, config), make_state(network, config)
        losses.append(float(step(state, batch | {"images": images})[1]["loss"]))
    assert losses[0] == pytest.approx(losses[1], rel=1e-5)  # float32, another program
    plain = step(make_state(network, config), batch)[1]["loss"]
    assert abs(float(plain) - losses[0]) > 1e-4 * losses[0]
