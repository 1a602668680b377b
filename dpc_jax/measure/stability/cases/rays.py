"""Rays: empty, full, nearly either, and long ones."""

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability.cases import oracles
from dpc_jax.measure.stability.cases.case import DTYPES, REAL, WIDE, Case, make_cases
from dpc_jax.render import termination

SUBJECT = "ray termination"
UNDERFLOW = "a product below the smallest normal float counts as zero"
LONG = 4096
MIDDLE = np.linspace(0.1, 0.8, 6)
# In 16 bits 1 - 1e-7 is 1, and in float16 1e-9 is 0: these are cases all the same.
RAYS = {
    "plain": MIDDLE,
    "empty": np.zeros(6),
    "full": np.ones(6),
    "one full cell, the first": np.eye(6)[0],
    "one full cell, the last": np.eye(6)[-1],
    "one full among others": np.where(np.arange(6) == 2, 1, MIDDLE),
    "two full among others": np.where(np.arange(6) % 3 == 1, 1, MIDDLE),
    "all at 1 - 1e-7": np.full(6, 1 - 1e-7),
    "all at 1e-9": np.full(6, 1e-9),
    "all at 1e-30": np.full(6, 1e-30),
    "from 1e-30 to 1": np.array([1e-30, 1e-9, 0.5, 1e-20, 1, 1e-5]),
    "one cell": np.array([0.3]),
    "one full cell alone": np.array([1.0]),
    "4096 at 1e-9": np.full(LONG, 1e-9),
    "4096 at 0.5": np.full(LONG, 0.5),
    "4096 at 1e-3": np.full(LONG, 1e-3),
    "4096 full": np.ones(LONG),
}
SUMMED = ("plain", "all at 1 - 1e-7", "4096 at 1e-3", "two full among others")
# The gradient is a product of all cells over one of them. In float32 the product of
# these six is below 1e-38 and counts as zero, so that up to 1e-38 / 1e-7 is lost, of a
# gradient of at most 1.
OPACITY_CHANGES = {"all at 1 - 1e-7": {"gradient_floor": 1e-25, "limit": UNDERFLOW}}


def list_cases() -> list[Case]:
    """The catalogue's cases on termination and opacity."""
    return [
        *_make_cases(
            "probabilities",
            *(termination.termination_probabilities, oracles.terminate),
            slope=_differentiate_termination,
        ),
        *_make_cases(
            "opacity",
            *(termination.opacity, oracles.find_opacity),
            changes=OPACITY_CHANGES,
            slope=_differentiate_opacity,
        ),
        *_make_cases(
            "sum and least of probabilities",
            _add_probabilities,
            # The sum is one for every ray, so its gradient is zero; it is a difference
            # of terms that are at most one.
            lambda ray: (1 + 0 * np.sum(ray), np.zeros(())),
            SUMMED,
            floor=1.0,
            gradient_floor=1.0,
            slope=lambda inputs, weights: (np.zeros(inputs[0].shape),),
        ),
    ]


def _make_cases(title, function, oracle, names=tuple(RAYS), changes=None, **shared):
    """Cases on rays; tolerances grow with the length of the ray."""
    shared["because"] = "each cell rounds the product twice, at worst in one direction"
    cases = []
    for name in names:
        ray, length = RAYS[name], len(RAYS[name])
        tolerances = 2 * length + 8, 8 * length + 16
        row = (name, ray, (changes or {}).get(name, {}))
        shared["dtypes"] = WIDE if length == LONG else DTYPES
        cases += make_cases(title, function, oracle, tolerances, [row], **shared)
    return cases


def _add_probabilities(ray):
    """The sum, which must be one, and the least probability if it is negative, or 0."""
    cells, background = termination.termination_probabilities(ray)
    below = jnp.minimum(jnp.min(cells), 0)
    return jnp.sum(cells) + background, jax.lax.stop_gradient(below)


# Written out, because complex steps would take 4096 sums of 4096 terms.
def _differentiate_opacity(inputs, weights):
    """Π_{u≠k}(1 - o_u): the product over the cells before k times that behind k."""
    before, after = _multiply_sides(1 - inputs[0].astype(REAL))
    return (float(weights[0]) * before * after,)


def _differentiate_termination(inputs, weights):
    """∂L/∂o_k = Π_{u<k}(1 - o_u)·(w_k - the weighted sum behind k)."""
    (occupancy,), (cells, background) = inputs, weights
    passes = 1 - occupancy.astype(REAL)
    before, _ = _multiply_sides(passes)
    behind, gradient = REAL(background), np.zeros(len(occupancy), REAL)
    for k in reversed(range(len(occupancy))):
        gradient[k] = before[k] * (cells[k] - behind)
        behind = occupancy[k] * cells[k] + passes[k] * behind
    return (gradient,)


def _multiply_sides(passes):
    ones = np.ones(1, passes.dtype)
    before = np.cumprod(np.concatenate([ones, passes[:-1]]))
    after = np.cumprod(np.concatenate([ones, passes[:0:-1]]))[::-1]
    return before, after
