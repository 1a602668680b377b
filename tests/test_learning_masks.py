"""What the network sees of a view: its image and, not in the paper, its mask."""

import functools

import jax
import numpy as np
import tiny_runs

from dpc_jax.learning.inference.predictor import make_predictor, predict_all
from dpc_jax.learning.predictions import encode_views, make_inputs


def make_run(sees_mask):
    config = tiny_runs.tiny_config(sees_mask=sees_mask)
    network = tiny_runs.make_network(config)
    return config, network, tiny_runs.make_state(network, config)


def test_masks_are_the_fourth_channel_in_the_units_of_images():
    _, network, _ = make_run(True)
    images = np.full((1, 16, 16, 3), 51, np.uint8)
    masks = np.zeros((1, 16, 16), np.uint8)
    masks[0, 3:9] = 255
    inputs = make_inputs(images, masks, network=network)
    assert inputs.shape == (1, 16, 16, 4)
    np.testing.assert_allclose(inputs[..., :3], 51 / 127.5 - 1, rtol=1e-6)
    np.testing.assert_array_equal(inputs[0, 3:9, :, 3], 1)
    np.testing.assert_array_equal(inputs[0, 9:, :, 3], -1)
    plain = make_inputs(images, masks, network=make_run(False)[1])
    np.testing.assert_array_equal(plain, inputs[..., :3])


def test_all_that_reads_views_shows_masks_to_the_network():
    """Other masks of the same images: features, codes and shapes differ."""
    config, network, state = make_run(True)
    dataset = tiny_runs.make_dataset()
    other = dataset._replace(masks=np.roll(np.asarray(dataset.masks), 3, axis=-1))
    predictor = make_predictor(network, config, keeps_evidence=True)
    encode = jax.jit(functools.partial(encode_views, network=network))
    apply = jax.jit(network.apply)

    def read(dataset):
        images, masks = dataset.images, dataset.masks
        first = images[:, 0], masks[:, 0]
        features = encode(state.params, images, masks)
        predicted = predict_all(predictor, state, dataset)
        whole, codes = predicted.points[:, 0], predicted.codes[:, 0]
        inputs = make_inputs(*first, network=network)
        output = apply(state.params, inputs)
        np.testing.assert_allclose(whole, output["points"], atol=1e-5)
        np.testing.assert_allclose(codes, features[:, 0], atol=1e-5)
        return features, codes, whole

    for one, two in zip(read(dataset), read(other), strict=True):
        assert np.abs(np.asarray(one) - two).max() > 1e-4
