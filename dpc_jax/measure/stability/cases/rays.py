"""Rays: empty, full, nearly either, and long ones."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability.cases import oracles
from dpc_jax.measure.stability.cases.case import DTYPES, WIDE, Case
from dpc_jax.render import termination

SUBJECT = "ray termination"
UNDERFLOW = "a product below the smallest normal float counts as zero"
LONG = 4096
SUMMED = ("plain", "all at 1 - 1e-7", "4096 at 1e-3", "two full among others")


def list_cases() -> list[Case]:
    """The catalogue's cases on termination and opacity."""
    middle = np.linspace(0.1, 0.8, 6)
    rays = {
        "plain": middle,
        "empty": np.zeros(6),
        "full": np.ones(6),
        "one full cell, the first": np.eye(6)[0],
        "one full cell, the last": np.eye(6)[-1],
        "one full among others": np.where(np.arange(6) == 2, 1, middle),
        "two full among others": np.where(np.arange(6) % 3 == 1, 1, middle),
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
    cases = []
    for name, ray in rays.items():
        is_long = len(ray) == LONG
        # Complex steps would take 4096 long sums; the formulas take one.
        make = functools.partial(
            Case,
            subject=SUBJECT,
            inputs=(ray,),
            value_tolerance=2 * len(ray) + 8,
            because="each cell rounds the product twice, at worst in one direction",
            dtypes=WIDE if is_long else DTYPES,
        )
        # In 16 bits 1 - 1e-7 is 1, and in float16 1e-9 is 0: cases all the same.
        cases.append(
            make(
                name=f"probabilities: {name}",
                function=termination.termination_probabilities,
                oracle=oracles.terminate,
                gradient_tolerance=8 * len(ray) + 16,
                slope=_differentiate_termination,
            )
        )
        cases.append(
            make(
                name=f"opacity: {name}",
                function=termination.opacity,
                oracle=lambda ray: np.asarray(oracles.find_opacity(ray)),
                gradient_tolerance=8 * len(ray) + 16,
                slope=_differentiate_opacity,
                # Π of all cells over one: the six together are below 1e-38 in float32,
                # and 1e-38 over 1e-7 is what may be lost, of a gradient of at most 1.
                gradient_floor=1e-25 if "1 - 1e-7" in name else 0.0,
                limit=UNDERFLOW if "1 - 1e-7" in name else "",
            )
        )
        if name in SUMMED:
            cases.append(
                make(
                    name=f"sum and least of probabilities: {name}",
                    function=add_probabilities,
                    # One, whatever the ray: with zero gradient, of terms up to one.
                    oracle=lambda ray: (np.asarray(1 + 0 * np.sum(ray)), np.zeros(())),
                    gradient_tolerance=8 * len(ray) + 16,
                    floor=1.0,
                    gradient_floor=1.0,
                    slope=lambda inputs, weights: (np.zeros(inputs[0].shape),),
                )
            )
    return cases


def add_probabilities(ray):
    """What must be one, and by how much a probability is below zero."""
    cells, background = termination.termination_probabilities(ray)
    below = jnp.minimum(jnp.min(cells), 0)
    return jnp.sum(cells) + background, jax.lax.stop_gradient(below)


def _differentiate_opacity(inputs, weights):
    """Π_{u≠k}(1 - o_u), as what lies before times what lies behind."""
    before, after = _multiply_sides(1 - inputs[0].astype(np.longdouble))
    return (float(weights[0]) * before * after,)


def _differentiate_termination(inputs, weights):
    """∂L/∂o_k = Π_{u<k}(1 - o_u)·(w_k - what the cells behind k are worth)."""
    (occupancy,), (cells, background) = inputs, weights
    passes = 1 - occupancy.astype(np.longdouble)
    before, _ = _multiply_sides(passes)
    worth, gradient = np.longdouble(background), np.zeros(len(occupancy), np.longdouble)
    for k in reversed(range(len(occupancy))):
        gradient[k] = before[k] * (cells[k] - worth)
        worth = occupancy[k] * cells[k] + passes[k] * worth
    return (gradient,)


def _multiply_sides(passes):
    ones = np.ones(1, passes.dtype)
    before = np.cumprod(np.concatenate([ones, passes[:-1]]))
    after = np.cumprod(np.concatenate([ones, passes[:0:-1]]))[::-1]
    return before, after
