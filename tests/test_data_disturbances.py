"""What photographs have and renders do not, at the strengths that are stated."""

import numpy as np
import pytest

from dpc_jax.data.disturbances import DISTURBANCES

SIDE = 128


def take(name, *, seed=0):
    """A grey disc off the middle, before and after."""
    rows, columns = np.mgrid[:SIDE, :SIDE]
    is_object = (rows - 70) ** 2 + (columns - 55) ** 2 < 30**2
    image = np.where(is_object[..., None], np.uint8([90, 120, 150]), np.uint8(255))
    mask = np.uint8(255 * is_object)
    rng = np.random.default_rng(seed)
    return (image, mask), DISTURBANCES[name](image.copy(), mask.copy(), rng)


@pytest.mark.parametrize("name", DISTURBANCES)
def test_a_disturbed_view_is_one_of_bytes_and_repeats_with_its_generator(name):
    (image, mask), (disturbed, found) = take(name)
    assert disturbed.shape == image.shape and disturbed.dtype == np.uint8
    assert found.shape == mask.shape and found.dtype == np.uint8
    assert (disturbed != image).any() or (found != mask).any()
    again, other = take(name)[1], take(name, seed=1)[1]
    assert all(map(np.array_equal, (disturbed, found), again))
    if "blur" not in name:
        assert not np.array_equal(disturbed, other[0])


def test_noise_has_a_twentieth_of_white():
    (image, mask), (noisy, found) = take("noise")
    inside = mask > 0  # where nothing is clipped
    change = noisy[inside].astype(float) - image[inside]
    # 8,500 values: 1 % of the deviation, times six.
    assert abs(change.std() / 255 - 0.05) < 0.003 and abs(change.mean()) < 1
    assert np.array_equal(found, mask)


def test_blurs_move_no_light_and_leave_the_other_of_image_and_mask():
    (image, mask), (soft, found) = take("blur")
    assert abs(soft.mean() - image.mean()) < 0.2
    assert np.array_equal(found, mask)
    (image, mask), (sharp, found) = take("blurred mask")
    assert abs(found.mean() - mask.mean()) < 0.2
    assert np.array_equal(sharp, image)
    edge = np.flatnonzero((found[70] > 12) & (found[70] < 243))
    # 5 to 95 % of a Gaussian's edge are 3.3 deviations, of 2 pixels here, on two sides.
    assert 10 <= len(edge) <= 16


def test_a_shadow_falls_on_the_object_alone_and_halves_its_light():
    (image, mask), (dark, found) = take("shadow")
    assert np.array_equal(dark[mask == 0], image[mask == 0])
    light = dark[mask > 0] / image[mask > 0]
    assert light.min() < 0.52 and light.max() > 0.98
    assert np.array_equal(found, mask)


def test_off_centre_is_a_tenth_of_the_side():
    (image, mask), (moved, found) = take("off centre")
    away = np.argwhere(found).mean(axis=0) - np.argwhere(mask).mean(axis=0)
    assert abs(np.hypot(*away) - 12.8) < 0.8
    assert np.array_equal(moved[found > 0], image[mask > 0])


def test_a_mask_is_never_lost():
    """However small: it could not be framed."""
    mask = np.zeros((SIDE, SIDE), np.uint8)
    mask[60:64, 60:64] = 255
    image = np.full((SIDE, SIDE, 3), 255, np.uint8)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        assert DISTURBANCES["wrong mask"](image, mask, rng)[1].any()


def test_a_twentieth_of_the_mask_is_wrong():
    (_, mask), (spoiled, found) = take("wrong mask")
    wrong = (found > 127) != (mask > 127)
    assert 0.05 <= wrong.sum() / (mask > 127).sum() < 0.1
    lost = wrong & (mask > 127)
    assert (spoiled[lost] == 255).all()
    added = wrong & (mask <= 127)
    assert (spoiled[added] < 255).all()
