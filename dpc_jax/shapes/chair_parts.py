"""Measures of procedural chairs with their ranges; legs, star, sled, pedestal, plinth.

What a chair stands on is made from its plan and a random stream, in metres.
"""

import functools
from typing import NamedTuple

import numpy as np

from dpc_jax.shapes import building_blocks as parts

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
    frame_color: parts.Color
    seat_color: parts.Color


def draw_plan(rng: np.random.Generator) -> Plan:
    """Draw the kind of base and back and the measures of a chair."""
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


def make_legs(plan: Plan, rng: np.random.Generator) -> list[parts.Part]:
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
            side = 2 * radius
            leg = parts.bar(
                start, foot, width=side, height=side, color=plan.frame_color
            )
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


def make_star(plan: Plan, rng: np.random.Generator) -> list[parts.Part]:
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


def make_sled(plan: Plan, rng: np.random.Generator) -> list[parts.Part]:
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


def make_pedestal(plan: Plan, rng: np.random.Generator) -> list[parts.Part]:
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


def make_block(plan: Plan, rng: np.random.Generator) -> list[parts.Part]:
    """Upholstered plinth of an armchair, on short feet."""
    foot = rng.uniform(0.05, 0.14)
    x, y = 0.5 * plan.depth, 0.48 * plan.width
    top = plan.seat - plan.thick
    plinth = parts.box((-x, -y, foot), (0.96 * x, y, top), color=plan.seat_color)
    tube = functools.partial(
        parts.tube, radius=0.02, radius_stop=0.03, color=plan.frame_color
    )
    corners = [(s * 0.85 * x, 0.85 * y) for s in (1, -1)]
    return [plinth, *parts.mirror([tube((*xy, 0), (*xy, foot)) for xy in corners])]
