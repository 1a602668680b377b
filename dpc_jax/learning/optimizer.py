"""The optimiser: Muon for convolutions and Adam for all else, or the paper's Adam."""

import jax
import jax.numpy as jnp
import optax

from dpc_jax.config import Train

# Steps until the peak rate: Adam's moments settle. Of short runs at most a fifth.
_WARMUP = 200
_FINAL_RATE = 0.02  # share of the peak at the end
_MOMENTUM = 0.95  # of Muon (Jordan)
# Five steps of this odd polynomial bring all singular values of a matrix of norm 1 to
# 0.7 to 1.2, but those below a few thousandths of the norm (Jordan).
_COEFFICIENTS = 3.4445, -4.7750, 2.0315
_STEPS = 5
# Root mean square of Muon's updates, in learning rates. With 0.2 shapes are worse,
# with 1.2 the same (docs/log.md).
_SIZE = 0.6


def make_learning_rate(train: Train) -> optax.Schedule:
    """The paper's constant rate for "adam"; else a warm-up to it and a cosine decay."""
    peak = train.learning_rate
    if train.optimizer == "adam":
        return optax.constant_schedule(peak)
    warmup = min(_WARMUP, train.steps // 5)
    return optax.warmup_cosine_decay_schedule(
        init_value=peak / max(1, warmup),
        peak_value=peak,
        warmup_steps=warmup,
        decay_steps=train.steps,
        end_value=peak * _FINAL_RATE,
    )


def make_optimizer(train: Train) -> optax.GradientTransformation:
    """The optimiser of a run.

    "muon" orthogonalises the momentum of each of the encoder's kernels (Jordan, 2024,
    https://kellerjordan.github.io/posts/muon/): all directions are learned at one rate,
    where Adam spends most of an update on the few in which gradients are large. All
    other parameters have Adam. `l2_weight` adds the gradient of a penalty before, as
    the released code.
    """
    rate = make_learning_rate(train)
    rule = optax.scale_by_adam()
    if train.optimizer == "muon":
        muon = optax.chain(
            optax.trace(_MOMENTUM, nesterov=True),
            optax.stateless(lambda updates, _: jax.tree.map(orthogonalize, updates)),
        )
        rule = optax.partition({True: muon, False: rule}, find_convolutions)
    if train.l2_weight:
        penalty = optax.add_decayed_weights(train.l2_weight, mask=find_penalized)
        rule = optax.chain(penalty, rule)
    return optax.chain(rule, optax.scale_by_learning_rate(rate))


def orthogonalize(kernel: jax.Array) -> jax.Array:
    """The orthogonal matrix nearest to a kernel, in about one size; shape kept.

    The kernel [..., C] is a matrix of C columns. Newton-Schulz steps (Jordan, Muon)
    bring its singular values near each other and keep its singular vectors. They act on
    the [C, C] products of columns, which takes a quarter of the time of
    `optax.contrib.muon` for the encoder of 64² images. The result's root mean square is
    near 0.6 whatever the kernel's norm; zeros stay zeros.
    """
    rows = kernel.reshape(-1, kernel.shape[-1])
    # So that no square overflows, and the sum of squares is at least 1 or all are 0.
    largest = jnp.maximum(jnp.max(jnp.abs(rows)), jnp.finfo(rows.dtype).tiny)
    rows = rows / largest
    # Products rounded as in TF32 give directions without a gradient 0.005 of a whole
    # update instead of 2e-6 (1152 x 128, rank 20).
    with jax.default_matmul_precision("highest"):
        gram = rows.T @ rows
        norm = jnp.maximum(jnp.trace(gram), 1)
        gram = gram / norm
        same = jnp.eye(len(gram), dtype=gram.dtype)
        power = same
        first, third, fifth = _COEFFICIENTS
        for _ in range(_STEPS):
            factor = first * same + third * gram + fifth * (gram @ gram)
            power = factor @ power
            gram = factor @ (gram @ factor)
        size = _SIZE * max(rows.shape) ** 0.5 * jax.lax.rsqrt(norm)
        return (size * (rows @ power)).reshape(kernel.shape)


def find_convolutions(params: optax.Params) -> optax.Params:
    """Which parameters are kernels of the encoder's convolutions.

    All devices have the whole of them (`devices.choose_parts`), as Muon needs.
    """

    def is_convolution(path, array):
        return "encoder" in [entry.key for entry in path] and array.ndim == 4

    return jax.tree_util.tree_map_with_path(is_convolution, params)


def find_penalized(params: optax.Params) -> optax.Params:
    """Which parameters `l2_weight` is for: weights, no biases, of encoder and shape."""

    def is_penalized(path, _):
        keys = [entry.key for entry in path]
        return keys[-1] == "kernel" and not {"encoder", "shape"}.isdisjoint(keys)

    return jax.tree_util.tree_map_with_path(is_penalized, params)
