"""The judge of a prior on poses (MVC; Tulsiani et al., 2018)."""

import flax.linen as nn
import jax

from dpc_jax.networks.encoder import conv_init, leaky_relu

_JUDGE_WIDTH = 10


class PoseJudge(nn.Module):
    """Tells predicted poses from drawn ones: layers of 10, 10 and 1 unit."""

    @nn.compact
    def __call__(self, quaternions: jax.Array) -> jax.Array:
        """Unit quaternions [n, 4] to logits [n], above 0 for poses taken as drawn."""
        x = quaternions
        for _ in range(2):
            x = leaky_relu(nn.Dense(_JUDGE_WIDTH, kernel_init=conv_init)(x))
        return nn.Dense(1, kernel_init=conv_init)(x)[:, 0]
