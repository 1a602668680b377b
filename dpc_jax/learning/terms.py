"""Losses with their weights, and what a step knows of the batches before."""

from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp


class Averages(NamedTuple):
    """Of the batches before; what a step goes on from besides the parameters.

    Attributes:
      covariance: [3, 3] of predicted points, over the last hundred or so batches: its
        principal axes are those of the half turns.
      cost: () of a view; of runs that draw poses, else None.
      frame: of runs with `pose.common_frame`, see `choice.common_frame`; else None.
    """

    covariance: jax.Array
    cost: jax.Array | None = None
    frame: Any = None  # its module is loaded where it is asked for


class Term(NamedTuple):
    """One loss: its value and its weight in the sum."""

    value: jax.Array
    weight: chex.Numeric = 1.0


def sum_terms(terms: dict[str, Term]) -> jax.Array:
    """The weighted sum; ()."""
    total = jnp.zeros(())
    for term in terms.values():
        total = total + term.weight * term.value
    return total
