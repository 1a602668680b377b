"""Procedural chairs, in metres, z up; one sits looking to +x, the back is at -x."""

import functools

import numpy as np
import trimesh

from dpc_jax.shapes import building_blocks as parts
from dpc_jax.shapes import chair_parts
from dpc_jax.shapes.chair_parts import draw_plan

BASE_MAKERS = {
    "legs": chair_parts.make_legs,
    "star": chair_parts.make_star,
    "sled": chair_parts.make_sled,
    "pedestal": chair_parts.make_pedestal,
    "block": chair_parts.make_block,
}


def make_chair(rng: np.random.Generator) -> trimesh.Trimesh:
    """Mesh of a random chair, metres, not normalised.

    Its labels are seat, back, arm, and leg for whatever it stands on.
    """
    plan = draw_plan(rng)
    groups = [("seat", [_make_seat(plan, rng)])]
    groups += [("leg", BASE_MAKERS[plan.base](plan, rng))]
    groups += [("back", _Back(plan, rng).make(rng))]
    return parts.join([*groups, ("arm", _make_arms(plan, rng) if plan.arms else [])])


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


class _Back:
    """Back rest, leaning towards -x, as one plate, slats, rails or a padded frame."""

    def __init__(self, plan, rng):
        self._plan = plan
        self._half = 0.5 * plan.width * rng.uniform(0.8, 0.98)
        is_block = plan.base == "block"
        self._thick = rng.uniform(0.1, 0.16) if is_block else rng.uniform(0.02, 0.04)
        self._bottom = plan.seat + (-0.02 if plan.back in ("solid", "slats") else 0.02)
        self._top = plan.seat + plan.rise
        self._bar = functools.partial(parts.bar, color=plan.frame_color)

    def make(self, rng):
        plan, bottom, top = self._plan, self._bottom, self._top
        taper = rng.uniform(0.75, 1.0) * self._half
        if plan.back == "solid":
            return [self._plate(bottom, top, half_top=taper)]
        if plan.back == "curved":
            return self._make_curved(rng)
        pieces = self._make_posts(rng)
        head = plan.rise * rng.uniform(0.12, 0.22)
        if plan.back == "slats":
            pieces.append(self._plate(top - head, top, color=plan.frame_color))
            for y in np.linspace(-1, 1, int(rng.integers(5, 9)))[1:-1] * self._half:
                ends = self._place(y, bottom), self._place(y, top - 0.5 * head)
                pieces.append(self._bar(*ends, width=0.02, height=0.012))
        elif plan.back == "rails":
            count = int(rng.integers(2, 5))
            for high in np.linspace(top, plan.seat + 0.35 * plan.rise, count):
                pieces.append(self._plate(high - 0.6 * head, high))
        else:
            pieces.append(self._plate(bottom + 0.3 * plan.rise, top - 0.02))
        return pieces

    def _place(self, y, z):
        """Point of the back's middle plane."""
        low_x = -self._plan.depth / 2 + 0.5 * self._thick  # at the seat
        return np.array([low_x - self._plan.lean * (z - self._plan.seat), y, z])

    def _plate(self, low, high, *, bow=0.0, color=None, half_top=None):
        """Plate across the chair; its sides come forward by `bow`."""
        half_top = self._half if half_top is None else half_top
        rings = []
        for t in np.linspace(-1, 1, 7 if bow else 2):
            rear = np.array([bow * t * t - 0.5 * self._thick, 0, 0])
            front = np.array([bow * t * t + 0.5 * self._thick, 0, 0])
            a, b = self._place(t * self._half, low), self._place(t * half_top, high)
            rings.append([a + rear, a + front, b + front, b + rear])
        return parts.loft(rings, color=color or self._plan.seat_color)

    def _make_curved(self, rng):
        gap = rng.uniform(0.0, 0.4) * self._plan.rise
        bottom, y = self._bottom, 0.5 * self._half
        pieces = [self._plate(bottom + gap, self._top, bow=rng.uniform(0.04, 0.12))]
        if gap:
            ends = self._place(y, bottom - 0.03), self._place(y, bottom + gap)
            pieces += parts.mirror([self._bar(*ends, width=0.03, height=0.015)])
        return pieces

    def _make_posts(self, rng):
        plan, width = self._plan, rng.uniform(0.02, 0.04)
        y = self._half - width / 2
        ends = self._place(y, plan.seat - plan.thick), self._place(y, self._top)
        return parts.mirror([self._bar(*ends, width=width, height=0.03)])


def _make_arms(plan, rng):
    """Arm rests: padded walls for an armchair, else a rest on a post on each side."""
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
    bar = functools.partial(parts.bar, color=plan.frame_color)
    height = plan.seat + rng.uniform(0.17, 0.24)
    reach = rear + rng.uniform(0.6, 0.95) * plan.depth
    start = rear - plan.lean * (height - plan.seat) + 0.01
    side, x, low = half + 0.02, reach - 0.05, plan.seat - plan.thick
    rest = bar((start, side, height), (reach, side, height), width=0.05, height=0.03)
    post = bar((x, side, low), (x, side, height), width=0.025, height=0.025)
    return parts.mirror([rest, post])
