"""Procedural chairs, in metres, z up; one sits looking to +x, the back is at -x."""

from typing import NamedTuple

import numpy as np

from dpc_jax.shapes import building_blocks as parts
from dpc_jax.shapes.chair_bases import (
    make_block,
    make_legs,
    make_pedestal,
    make_sled,
    make_star,
)

BASES = ("legs", "legs", "legs", "star", "sled", "pedestal", "block")
BACKS = ("solid", "slats", "rails", "curved", "frame")
WOODS = ((92, 58, 34), (140, 96, 58), (186, 140, 92), (60, 42, 32), (214, 180, 132))


class Plan(NamedTuple):
    """Measures of one chair in metres; `lean` is the back's run per rise."""

    base: str
    back: str
    seat: float
    width: float
    depth: float
    thick: float
    rise: float
    lean: float
    arms: bool
    frame_color: tuple
    seat_color: tuple


def draw_plan(rng):
    """Draws the kind of base and back and the measures of a chair."""
    base = str(rng.choice(BASES))
    stool = base in ("legs", "pedestal") and rng.uniform() < 0.18
    seat = rng.uniform(0.62, 0.78) if stool else rng.uniform(0.40, 0.50)
    width, depth = rng.uniform(0.38, 0.54), rng.uniform(0.38, 0.52)
    thick = rng.uniform(0.025, 0.07)
    if base == "block":  # an armchair: low, wide, upholstered
        seat, thick = rng.uniform(0.34, 0.44), rng.uniform(0.12, 0.2)
        width, depth = rng.uniform(0.52, 0.68), rng.uniform(0.50, 0.62)
    if base in ("star", "sled", "pedestal") or rng.uniform() < 0.3:
        frame_color = [parts.BLACK, parts.CHROME, (90, 92, 96)][rng.integers(3)]
    else:
        frame_color = WOODS[rng.integers(len(WOODS))]
    fabric = parts.draw_color(rng, saturation=(0.3, 0.95), value=(0.3, 0.9))
    back = "solid" if base == "block" else str(rng.choice(BACKS))
    return Plan(
        base=base,
        back=back,
        seat=seat,
        width=width,
        depth=depth,
        thick=thick,
        rise=rng.uniform(0.2, 0.34) if stool else rng.uniform(0.38, 0.62),
        lean=rng.uniform(0.05, 0.3),
        arms=base == "block" or (not stool and rng.uniform() < 0.4),
        frame_color=frame_color,
        seat_color=fabric if rng.uniform() < 0.75 else frame_color,
    )


def make_chair(rng):
    """Mesh of a random chair (`trimesh.Trimesh`, metres, not normalised)."""
    plan = draw_plan(rng)
    makers = {"legs": make_legs, "star": make_star, "sled": make_sled,
              "pedestal": make_pedestal, "block": make_block}  # fmt: skip
    pieces = [_make_seat(plan, rng), *makers[plan.base](plan, rng)]
    pieces += _make_back(plan, rng)
    if plan.arms:
        pieces += _make_arms(plan, rng)
    return parts.join(pieces)


def _make_seat(plan, rng):
    """A slab, wider at the front than at the back, its front edge rounded down."""
    front, rear = plan.depth / 2, -plan.depth / 2
    half, taper = plan.width / 2, rng.uniform(0.82, 1.0)
    top, low = plan.seat, plan.seat - plan.thick
    dip = 0.35 * plan.thick
    rings = []
    for x, y, lower, upper in (
        (rear, half * taper, low, top - 0.5 * dip),
        (rear + 0.12 * plan.depth, half * (taper + 0.02), low, top - dip),
        (front - 0.15 * plan.depth, half, low, top),
        (front, 0.92 * half, low + 0.1 * plan.thick, top - dip),
    ):
        rings.append([(x, -y, lower), (x, y, lower), (x, y, upper), (x, -y, upper)])
    return parts.loft(rings, color=plan.seat_color)


def _make_back(plan, rng):
    """Back rest, leaning towards -x, as one plate, slats, rails or a padded frame."""
    rear, half = -plan.depth / 2, 0.5 * plan.width * rng.uniform(0.8, 0.98)
    thick = rng.uniform(0.02, 0.04) if plan.base != "block" else rng.uniform(0.1, 0.16)
    bottom = plan.seat - (0.02 if plan.back in ("solid", "slats") else -0.02)
    top = plan.seat + plan.rise

    def at(y, z):
        return np.array([rear + 0.5 * thick - plan.lean * (z - plan.seat), y, z])

    def plate(low, high, *, bow=0.0, color=plan.seat_color, half_top=half):
        """Plate across the chair; its sides come forward by `bow`."""
        rings = []
        for t in np.linspace(-1, 1, 7 if bow else 2):
            forward = [bow * t * t - 0.5 * thick, bow * t * t + 0.5 * thick]
            a, b = at(t * half, low), at(t * half_top, high)
            rings.append(
                [
                    a + [forward[0], 0, 0],
                    a + [forward[1], 0, 0],
                    b + [forward[1], 0, 0],
                    b + [forward[0], 0, 0],
                ]
            )
        return parts.loft(rings, color=color)

    taper = rng.uniform(0.75, 1.0) * half
    if plan.back == "solid":
        return [plate(bottom, top, half_top=taper)]
    if plan.back == "curved":
        gap = rng.uniform(0.0, 0.4) * plan.rise
        pieces = [plate(bottom + gap, top, bow=rng.uniform(0.04, 0.12))]
        if gap:
            post = parts.bar(
                at(0.5 * half, bottom - 0.03),
                at(0.5 * half, bottom + gap),
                width=0.03,
                height=0.015,
                color=plan.frame_color,
            )
            pieces += parts.mirror([post])
        return pieces
    post_width = rng.uniform(0.02, 0.04)
    post = parts.bar(
        at(half - post_width / 2, plan.seat - plan.thick),
        at(half - post_width / 2, top),
        width=post_width,
        height=0.03,
        color=plan.frame_color,
    )
    pieces = parts.mirror([post])
    head = plan.rise * rng.uniform(0.12, 0.22)
    if plan.back == "slats":
        pieces.append(plate(top - head, top, color=plan.frame_color))
        for y in np.linspace(-1, 1, int(rng.integers(5, 9)))[1:-1] * half:
            pieces.append(
                parts.bar(
                    at(y, bottom),
                    at(y, top - 0.5 * head),
                    width=0.02,
                    height=0.012,
                    color=plan.frame_color,
                )
            )
    elif plan.back == "rails":
        count = int(rng.integers(2, 5))
        for high in np.linspace(top, plan.seat + 0.35 * plan.rise, count):
            pieces.append(plate(high - 0.6 * head, high, color=plan.seat_color))
    else:
        pieces.append(plate(bottom + 0.3 * plan.rise, top - 0.02))
    return pieces


def _make_arms(plan, rng):
    """Arm rests: padded walls for an armchair, else a rest on one or two posts."""
    rear, front = -plan.depth / 2, plan.depth / 2
    half = plan.width / 2
    if plan.base == "block":
        height = plan.seat + rng.uniform(0.12, 0.24)
        wall = parts.box(
            (rear - 0.04, half - 0.02, 0.12),
            (front, half + rng.uniform(0.08, 0.16), height),
            color=plan.seat_color,
        )
        return parts.mirror([wall])
    height = plan.seat + rng.uniform(0.17, 0.24)
    reach = rear + rng.uniform(0.6, 0.95) * plan.depth
    start = rear - plan.lean * (height - plan.seat) + 0.01
    side = half + 0.02
    rest = parts.bar(
        (start, side, height),
        (reach, side, height),
        width=0.05,
        height=0.03,
        color=plan.frame_color,
    )
    x = reach - 0.05
    post = parts.bar(
        (x, side, plan.seat - plan.thick),
        (x, side, height),
        width=0.025,
        height=0.025,
        color=plan.frame_color,
    )
    return parts.mirror([rest, post])
