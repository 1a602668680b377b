"""Procedural chairs, in metres, z up; one sits looking to +x, the back is at -x."""

import functools
from types import SimpleNamespace

import numpy as np
import trimesh

from dpc_jax.shapes import building_blocks as parts

BASES = ("legs", "legs", "legs", "star", "sled", "pedestal", "block")
BACKS = ("solid", "slats", "rails", "curved", "frame")
WOODS = ((92, 58, 34), (140, 96, 58), (186, 140, 92), (60, 42, 32), (214, 180, 132))


def draw_plan(rng: np.random.Generator) -> SimpleNamespace:
    """Draw the kind of base and back and the measures of a chair, in metres."""
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
    return SimpleNamespace(
        base=base,
        back=back,
        seat=seat,
        width=width,
        depth=depth,
        thick=thick,
        rise=rng.uniform(0.2, 0.34) if stool else rng.uniform(0.38, 0.62),
        lean=rng.uniform(0.05, 0.3),  # of the back, run per rise
        arms=base == "block" or (not stool and rng.uniform() < 0.4),
        frame_color=frame_color,
        seat_color=fabric if rng.uniform() < 0.75 else frame_color,
    )


def make_chair(rng: np.random.Generator) -> trimesh.Trimesh:
    """Mesh of a random chair, metres, not normalised."""
    return parts.join([part for group in make_groups(rng).values() for part in group])


def make_groups(rng: np.random.Generator) -> dict[str, list[parts.Part]]:
    """The seat, back and arms of a random chair, and as leg whatever it stands on."""
    plan = draw_plan(rng)
    makers = {
        "legs": _make_legs,
        "star": _make_star,
        "sled": _make_sled,
        "pedestal": _make_pedestal,
        "block": _make_block,
    }
    return {
        "seat": [_make_seat(plan, rng)],
        "leg": makers[plan.base](plan, rng),
        "back": _Back(plan, rng).make(rng),
        "arm": _make_arms(plan, rng) if plan.arms else [],
    }


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
        width = rng.uniform(0.02, 0.04)  # of the posts
        side = self._half - width / 2
        ends = self._place(side, plan.seat - plan.thick), self._place(side, top)
        pieces = parts.mirror([self._bar(*ends, width=width, height=0.03)])
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


def _make_arms(plan, rng):
    """Arm rests: padded walls for an armchair, else a rest on a post on each side."""
    rear, front = -plan.depth / 2, plan.depth / 2
    half = plan.width / 2
    if plan.base == "block":
        height = plan.seat + rng.uniform(0.12, 0.24)
        corner = (front, half + rng.uniform(0.08, 0.16), height)
        low = (rear - 0.04, half - 0.02, 0.12)
        return parts.mirror([parts.box(low, corner, color=plan.seat_color)])
    bar = functools.partial(parts.bar, color=plan.frame_color)
    height = plan.seat + rng.uniform(0.17, 0.24)
    reach = rear + rng.uniform(0.6, 0.95) * plan.depth
    start = rear - plan.lean * (height - plan.seat) + 0.01
    side, x, low = half + 0.02, reach - 0.05, plan.seat - plan.thick
    rest = bar((start, side, height), (reach, side, height), width=0.05, height=0.03)
    post = bar((x, side, low), (x, side, height), width=0.025, height=0.025)
    return parts.mirror([rest, post])


def _make_legs(plan, rng):
    """Four legs, splayed or straight, sometimes with stretchers."""
    tube = functools.partial(parts.tube, color=plan.frame_color)
    radius, splay = rng.uniform(0.012, 0.024), rng.uniform(0.0, 0.16)
    square = rng.uniform() < 0.4
    x, y = 0.43 * plan.depth, 0.42 * plan.width
    top = plan.seat - plan.thick
    pieces = []
    for sign in (1, -1):
        start = np.array([sign * x, y, top])
        foot = np.array([sign * (x + splay * 0.4), y + splay * 0.3, 0.0])
        if square:
            sizes = dict(width=2 * radius, height=2 * radius)
            leg = parts.bar(start, foot, **sizes, color=plan.frame_color)
        else:
            leg = tube(start, foot, 1.15 * radius, radius_stop=0.75 * radius)
        pieces.append(leg)
    if rng.uniform() < 0.45 or top > 0.55:
        height = rng.uniform(0.25, 0.45)
        reach = splay * (1 - height)
        z, side, end = top * height, y + 0.3 * reach, x + 0.4 * reach
        stretcher = functools.partial(tube, radius=0.7 * radius, sides=6)
        pieces.append(stretcher((end, side, z), (-end, side, z)))
        for sign in (1, -1):
            pieces.append(stretcher((sign * end, -1e-3, z), (sign * end, side, z)))
    return parts.mirror(pieces)


def _make_star(plan, rng):
    """Gas spring on a star of four or five feet with castors."""
    tube = functools.partial(parts.tube, color=plan.frame_color)
    count, reach = int(rng.choice([4, 5])), rng.uniform(0.26, 0.33)
    pieces = [tube((0, 0, 0.1), (0, 0, plan.seat - plan.thick), 0.028)]
    turn = rng.uniform(0.0, 2 * np.pi)
    for angle in turn + 2 * np.pi * np.arange(count) / count:
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        foot = reach * out + [0, 0, 0.07]
        pieces.append(tube((0, 0, 0.12), foot, 0.028, radius_stop=0.016, sides=6))
        side = 0.02 * np.cross(out, [0, 0, 1])
        hub = reach * out + [0, 0, 0.032]
        pieces.append(parts.tube(hub - side, hub + side, 0.032, color=parts.BLACK))
    return pieces


def _make_sled(plan, rng):
    """Bent tube on each side; the cantilever has no rear leg."""
    radius = rng.uniform(0.011, 0.016)
    tube = functools.partial(parts.tube, radius=radius, color=plan.frame_color)
    x, y, top = 0.46 * plan.depth, 0.46 * plan.width, plan.seat - plan.thick
    path = [(x, top), (x + rng.uniform(0, 0.05), radius), (-x, radius)]
    if rng.uniform() < 0.5:
        path.append((-x, top))
    pieces = [
        tube((a[0], y, a[1]), (b[0], y, b[1]))
        for a, b in zip(path[:-1], path[1:], strict=True)
    ]
    pieces.append(tube((-x, -1e-3, radius), (-x, y, radius), sides=6))
    return parts.mirror(pieces)


def _make_pedestal(plan, rng):
    """One column on a round or trumpet-shaped foot."""
    radius, top = rng.uniform(0.17, 0.24), plan.seat - plan.thick
    neck = rng.uniform(0.02, 0.035)
    heights = np.array([0.0, 0.02, 0.05, 0.3 * top, top])
    radii = np.array([radius, radius, rng.uniform(0.3, 0.8) * radius, neck, neck])
    ring = parts.circle(14)
    rings = [
        np.column_stack([r * ring, np.full(len(ring), z)])
        for r, z in zip(radii, heights, strict=True)
    ]
    return [parts.loft(rings, color=plan.frame_color)]


def _make_block(plan, rng):
    """Upholstered plinth of an armchair, on short feet."""
    foot = rng.uniform(0.05, 0.14)
    x, y = 0.5 * plan.depth, 0.48 * plan.width
    top = plan.seat - plan.thick
    plinth = parts.box((-x, -y, foot), (0.96 * x, y, top), color=plan.seat_color)
    tube = functools.partial(parts.tube, color=plan.frame_color)
    corners = [(s * 0.85 * x, 0.85 * y) for s in (1, -1)]
    feet = [tube((*c, 0), (*c, foot), 0.02, radius_stop=0.03) for c in corners]
    return [plinth, *parts.mirror(feet)]
