"""Noise in the choice among candidates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dpc_jax.config import Pose, build_config, check, replace_fields
from dpc_jax.learning.choice.noise import disturb, draw_noise

NOISY = Pose(choice_noise=0.3, choice_noise_until=0.5)


def test_candidates_win_as_often_as_gibbs_says():
    losses = jnp.array([2.0, 1.0, 1.3])
    keys = jax.random.split(jax.random.key(0), 1000)
    noise = draw_noise(keys, jnp.array(0), (4000, 3), pose=NOISY, steps=10)
    winners = jax.vmap(lambda noise: jnp.argmin(disturb(losses, noise)))(noise)
    shares = np.bincount(np.asarray(winners), minlength=3) / 4000
    temperature = 0.3 * float(jnp.mean(losses))
    expected = jax.nn.softmax(-losses / temperature)
    # Three standard deviations of a share of 0.5 among 4000 are 0.024.
    np.testing.assert_allclose(shares, expected, atol=0.025)


def test_noise_falls_to_nothing():
    def spread(step):
        keys = jax.random.split(jax.random.key(1), 50)
        drawn = draw_noise(keys, jnp.array(step), (200, 5), pose=NOISY, steps=100)
        return float(jnp.std(drawn))

    # A Gumbel distribution has the standard deviation π/√6.
    assert spread(0) == pytest.approx(0.3 * np.pi / np.sqrt(6), rel=0.1)
    assert spread(25) == pytest.approx(spread(0) / 2, rel=1e-5)
    assert spread(50) == spread(90) == 0


def test_some_of_the_candidates_have_their_own_noise():
    losses, noise = jnp.array([4.0, 2.0]), jnp.array([0.1, 0.0, -0.2, 0.3])
    found = disturb(losses, noise, jnp.array([2, 0]))
    np.testing.assert_allclose(found, [4 - 0.6, 2 + 0.3], rtol=1e-6)


def test_without_noise_nothing_is_drawn_or_added():
    assert draw_noise(None, None, (4, 2), pose=Pose(), steps=10) is None
    losses = jnp.array([4.0, 2.0])
    assert disturb(losses, None) is losses


def test_noise_in_no_choice_is_refused():
    config = build_config("car", "mvc")
    with pytest.raises(ValueError, match="config.pose.choice_noise must be 0"):
        check(replace_fields(config, {"pose": {"choice_noise": 0.1}}))
