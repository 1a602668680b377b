"""Rotations: extreme lengths, half turns, near identity, every branch."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.stability.cases import oracles
from dpc_jax.measure.stability.cases.case import DTYPES, WIDE, Case
from dpc_jax.render import quaternion

SUBJECT = "rotation"
ROUNDING = "a dozen roundings, each half an epsilon; numbers of size one"
PLAIN = (0.5, -1.0, 2.0, 0.25)
ZERO = "the zero quaternion stands for the identity, with zero gradient"


def turn_points(points, rotation):
    """`quaternion.rotate` under a name that cases share."""
    return quaternion.rotate(points, rotation)


def pass_through_matrix(q):
    """The quaternion there and back; as q·qᵀ, which does not see its sign."""
    back = quaternion.from_matrix(quaternion.to_matrix(q))
    return back[:, None] * back[None, :]


def compose_many(step):
    """Product of 10⁵ equal rotations, normalised each time as training does."""

    def turn(_, q):
        return quaternion.normalize(quaternion.multiply(step, q))

    start = jnp.array(quaternion.IDENTITY, step.dtype)
    return jax.lax.fori_loop(0, 100_000, turn, start)


def compose_many_exactly(step):
    """One turn by 10⁵ times the angle."""
    step = oracles.normalize(step)
    sine = oracles.root_sum(step[1:])
    half = np.arctan(sine / step[0]) * 100_000
    return np.concatenate([[np.cos(half)], np.sin(half) * step[1:] / sine])


def list_cases() -> list[Case]:
    """The catalogue's cases on rotations."""
    make = functools.partial(Case, subject=SUBJECT, because=ROUNDING)
    cases = []

    lengths = {
        "length 1e-30": np.multiply(PLAIN, 1e-30),
        "length 1e30": np.multiply(PLAIN, 1e30),
        "components from 1e-30 to 1": (1e-30, 1, 1e-15, -1e-3),
        "-q": np.negative(PLAIN),
        "near identity, 1e-7": (1, 1e-7, -1e-7, 2e-7),
        "half turn": (0, 1, -2, 3),
        "zero": (0, 0, 0, 0),
    }
    for name, q in lengths.items():
        is_zero = name == "zero"
        cases.append(
            make(
                name=f"normalize: {name}",
                function=quaternion.normalize,
                inputs=(q,),
                oracle=oracles.normalize,
                value_tolerance=4,
                gradient_tolerance=16,
                slope=(lambda inputs, weights: (np.zeros(4),)) if is_zero else None,
                limit=ZERO if is_zero else "",
            )
        )

    pairs = {
        "plain": (PLAIN, (1, 2, 3, 4)),
        "1e30 by 1e-30": (np.multiply(PLAIN, 1e30), (1e-30, 2e-30, 3e-30, 4e-30)),
        "near identity, 1e-7": ((1, 1e-7, 0, 0), (1, 0, -1e-7, 1e-7)),
        "half turns": ((0, 1, 0, 0), (0, 0, 1, 0)),
    }
    for name, pair in pairs.items():
        cases.append(
            make(
                name=f"multiply: {name}",
                function=quaternion.multiply,
                inputs=pair,
                oracle=oracles.multiply,
                value_tolerance=8,
                gradient_tolerance=8,
            )
        )

    points = np.array([[0.3, -0.4, 0.5], [1e-7, 1, 1e3], [0, 0, 0]])
    for name, q in lengths.items():
        is_zero = name == "zero"
        cases.append(
            make(
                name=f"rotate: {name}",
                function=turn_points,
                inputs=(points, q),
                oracle=oracles.rotate,
                value_tolerance=16,
                gradient_tolerance=64,
                because=ROUNDING + "; the gradient of q cancels along q",
                slope=(lambda inputs, weights: (weights[0], np.zeros(4)))
                if is_zero
                else None,
                limit=ZERO if is_zero else "",
            )
        )

    half = np.sqrt(0.5)
    branches = {
        "w largest": (1, 0.1, -0.2, 0.3),
        "x largest": (0.1, 1, -0.2, 0.3),
        "y largest": (0.1, -0.2, -1, 0.3),
        "z largest": (0.1, -0.2, 0.3, 1),
        "half turn about x": (0, 1, 0, 0),
        "half turn, two branches tie": (0, half, half, 0),
        "1e-7 from a half turn": (1e-7, 1, -2, 3),
        "all four tie": (1, -1, 1, 1),
        "identity": (1, 0, 0, 0),
        "near identity, 1e-7": (1, 1e-7, -1e-7, 2e-7),
    }
    for name, q in branches.items():
        cases.append(
            make(
                name=f"matrix and back: {name}",
                function=pass_through_matrix,
                inputs=(q,),
                oracle=lambda q: np.outer(oracles.normalize(q), oracles.normalize(q)),
                value_tolerance=8,
                gradient_tolerance=32,
            )
        )

    def no_slope(inputs, weights):
        return np.zeros(4), np.zeros(4)

    def one_side(inputs, weights):
        # From (1,0,0,0) to (0,0,1,0): π - 2·(the component along the other), on
        # the side where that component grows.
        w = float(weights[0])
        return np.array([0, 0, -2 * w, 0]), np.array([-2 * w, 0, 0, 0])

    tiny = (1, 1e-25, 0, 0)
    angles = {
        "plain": (PLAIN, (1, 2, 3, 4), None, ""),
        "1e30 and 1e-30": (np.multiply(PLAIN, 1e30), (1e-30, 0, 1e-30, 0), None, ""),
        "q and -q": (
            (0.5, 0.5, -0.5, 0.5),
            (-0.5, -0.5, 0.5, -0.5),
            no_slope,
            "kink at 0: zero gradient",
        ),
        "equal": ((1, 0, 0, 0), (1, 0, 0, 0), no_slope, "kink at 0: zero gradient"),
        "1e-25 apart": (tiny, (1, 0, 0, 0), None, ""),
        "1e-7 apart": ((1, 1e-7, 0, 0), (1, 0, 1e-7, 0), None, ""),
        "half turn": (
            (1, 0, 0, 0),
            (0, 0, 1, 0),
            one_side,
            "kink at 180°: the gradient of one side",
        ),
        "1e-7 from a half turn": ((1, 0, 0, 0), (1e-7, 0, 1, 0), None, ""),
    }
    for name, (first, second, slope, limit) in angles.items():
        # In 16 bits these round to equal rotations, or to what is no normal number.
        is_wide = name in ("1e-25 apart", "1e-7 apart")
        cases.append(
            make(
                name=f"angle: {name}",
                function=quaternion.angle_between,
                inputs=(first, second),
                oracle=oracles.angle,
                value_tolerance=16,
                gradient_tolerance=64,
                slope=slope,
                limit=limit,
                dtypes=WIDE if is_wide else DTYPES,
            )
        )

    step = np.concatenate([[np.cos(0.05)], np.sin(0.05) * np.array([0, 0.6, 0.8])])
    cases.append(
        make(
            name="product of 1e5 rotations",
            function=compose_many,
            inputs=(step,),
            oracle=compose_many_exactly,
            value_tolerance=4e5,
            gradient_tolerance=None,
            because="four roundings of a product, all of one sign at worst",
            dtypes=WIDE,
        )
    )
    for name, angle in {
        "0": 0.0,
        "1e-30": 1e-30,
        "a half turn": np.pi,
        "1e4": 1e4,
    }.items():
        cases.append(
            make(
                name=f"from axis and angle: {name}",
                function=quaternion.from_axis_angle,
                inputs=((0.0, -0.6, 0.8), angle),
                oracle=lambda axis, angle: np.concatenate(
                    [[np.cos(angle / 2)], np.sin(angle / 2) * axis]
                ),
                value_tolerance=4,
                gradient_tolerance=8,
                dtypes=WIDE,
            )
        )
    return cases
