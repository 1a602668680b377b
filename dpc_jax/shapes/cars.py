"""Procedural cars of many body styles, in metres, z up, front towards +x."""

import functools

import numpy as np
import trimesh

from dpc_jax.shapes import building_blocks as parts
from dpc_jax.shapes.car_parts import (
    SHARES,
    SIMPLE_SHARES,
    WINDOWS,
    deck_height,
    draw_paint,
    draw_plan,
    half_width,
    make_extras,
    make_lamps,
    make_wheels,
)
from dpc_jax.shapes.trucks import make_three_wheeler, make_truck, pile_goods


def make_car(rng: np.random.Generator) -> trimesh.Trimesh:
    """Mesh of a random car, bus, truck or three-wheeler, metres, not normalised."""
    style = rng.choice(list(SHARES), p=list(SHARES.values()))
    if style == "truck":
        return parts.join(make_truck(rng, draw_paint(rng)))
    if style == "three_wheeler":
        return parts.join(make_three_wheeler(rng, draw_paint(rng)))
    plan = draw_plan(rng, style)
    pieces = _make_parts(plan, rng)
    if style == "pickup" and rng.uniform() < 0.7:
        pieces += _load_bed(plan, rng)
    return parts.join(pieces)


def make_simple_car(rng: np.random.Generator) -> trimesh.Trimesh:
    """Mesh of a random car of the seven most usual styles."""
    style = rng.choice(list(SIMPLE_SHARES), p=list(SIMPLE_SHARES.values()))
    return parts.join(_make_parts(draw_plan(rng, style), rng))


def _make_parts(plan, rng):
    is_open = plan.style == "convertible"
    cabin = _make_open_cabin(plan) if is_open else _make_cabin(plan)
    pieces = [*_make_body(plan, rng), *cabin, *make_wheels(plan, rng)]
    return [*pieces, *make_lamps(plan, rng), *make_extras(plan, rng)]


def _load_bed(plan, rng):
    """A hood over the bed of a pickup, or goods in it."""
    rear, low = -plan.length / 2 + 0.1, deck_height(plan) - 0.05
    half, front = 0.8 * plan.half, plan.tail - 0.05
    if rng.uniform() < 0.4:
        high = plan.height * rng.uniform(0.95, 1.1)
        corners = (rear, -0.92 * plan.half, plan.belt), (front, 0.92 * plan.half, high)
        return [parts.box(*corners, color=plan.paint)]
    return pile_goods((rear, front), half, low, rng)


def _make_open_cabin(plan):
    """A windscreen in its frame, seats and a folded roof."""
    base, top, half = plan.belt - 0.02, plan.height, plan.roof_half
    wide = 0.86 * plan.half
    corners = [(plan.cowl, -wide, base), (plan.cowl, wide, base)]
    corners += [(plan.roof_front, half, top), (plan.roof_front, -half, top)]
    pieces = [parts.panel(corners, color=parts.GLASS)]
    beam = functools.partial(parts.bar, width=0.06, height=0.06, color=plan.paint)
    pieces += [beam(corners[0], corners[3]), beam(corners[1], corners[2])]
    pieces.append(beam(corners[3], corners[2]))
    behind = plan.roof_front - 0.75
    for x in np.arange(behind, plan.roof_rear - 0.3, -0.85):
        high = (x + 0.14, 0.75 * half, base + 0.9 * (top - base))
        seat = parts.box((x, 0.12, base - 0.05), high, color=(74, 48, 36))
        pieces += parts.mirror([seat])
    folded = (plan.tail, -0.8 * wide, base), (plan.tail + 0.4, 0.8 * wide, base + 0.14)
    return [*pieces, parts.box(*folded, color=parts.BLACK)]


def _outline(plan):
    """Side view of the lower body: stations x (front to rear), bottom z, top z."""
    front, rear = plan.length / 2, -plan.length / 2
    arch = 1.13 * plan.wheel
    stations = [front, front - 0.03 * plan.length, front - 0.10 * plan.length]
    stations += [plan.cowl, plan.cowl - 0.12, plan.tail, plan.tail - 0.05]
    stations += [rear + 0.025 * plan.length, rear]
    angles = np.linspace(0.0, np.pi, 7)
    for axle in plan.axles:
        stations += list(axle + arch * np.cos(angles))
    stations = np.unique(np.clip(stations, rear, front))[::-1]

    bumper = plan.floor + 0.10
    deck = deck_height(plan)
    rim = plan.floor + 0.86 * (deck - plan.floor)
    top_x = [rear, rear + 0.025 * plan.length, plan.tail - 0.05, plan.tail]
    top_x += [plan.cowl, front - 0.10 * plan.length, front - 0.03 * plan.length, front]
    nose_low = plan.floor + 0.72 * (plan.nose - plan.floor)
    lip = plan.nose + 0.35 * (plan.belt - plan.nose)
    top_z = [rim, deck, deck, plan.belt, plan.belt, lip, plan.nose, nose_low]
    order = np.argsort(top_x, kind="stable")
    top = np.interp(stations, np.array(top_x)[order], np.array(top_z)[order])

    bottom_x = [rear, rear + 0.06 * plan.length, front - 0.06 * plan.length, front]
    bottom = np.interp(stations, bottom_x, [bumper, plan.floor, plan.floor, bumper])
    for axle in plan.axles:
        inside = arch**2 - (stations - axle) ** 2
        round_top = plan.wheel + np.sqrt(np.maximum(inside, 0.0))
        bottom = np.where(inside > 1e-9, np.maximum(bottom, round_top), bottom)
    return stations, np.minimum(bottom, top - 0.05), top


def _make_body(plan, rng):
    stations, bottom, top = _outline(plan)
    rings = []
    for x, low, high in zip(stations, bottom, top, strict=True):
        half = half_width(plan, x)
        shoulder = high - 0.22 * (high - low)
        waist = low + 0.25 * (high - low)
        right = [(0.95 * half, low), (half, waist)]
        right += [(0.985 * half, shoulder), (0.90 * half, high)]
        ring = [*right, *((-y, z) for y, z in reversed(right))]
        rings.append([(x, y, z) for y, z in ring])
    body = parts.loft(rings, color=plan.paint)
    front, rear = plan.length / 2, -plan.length / 2
    inner = plan.half - 0.26
    high = plan.floor + 0.36 * (plan.belt - plan.floor)
    corners = (rear + 0.25, -inner, plan.floor + 0.02), (front - 0.25, inner, high)
    under = parts.box(*corners, color=parts.BLACK)
    trim = parts.BLACK if rng.uniform() < 0.5 else parts.CHROME
    bumpers = []
    for end, sign in ((front, 1), (rear, -1)):
        half = 0.96 * half_width(plan, end)
        low = plan.floor + 0.10
        x = sorted((end - sign * 0.10, end + sign * 0.04))
        corners = (x[0], -half, low), (x[1], half, low + 0.14)
        bumpers.append(parts.box(*corners, color=trim))
    return [body, under, *bumpers]


def _make_cabin(plan):
    """Greenhouse with tumblehome, and its windows just outside of it."""
    base = plan.belt - 0.02
    belt_half = 0.89 * plan.half
    crown = 0.025 * plan.height
    middle = 0.5 * (plan.roof_front + plan.roof_rear)
    xs = np.array([plan.cowl, plan.roof_front, middle, plan.roof_rear, plan.tail])
    tops = np.array([base, plan.height - crown, plan.height, plan.height - crown, base])
    if plan.style in ("hatchback", "suv", "wagon"):
        tops[3] -= 0.02 * plan.height  # the roof falls towards the rear

    def half_at(z):
        share = np.clip((z - base) / (plan.height - crown - base), 0.0, 1.0)
        return belt_half + (plan.roof_half - belt_half) * share

    rings = []
    for x, z in zip(xs, tops, strict=True):
        side = half_at(z)
        ring = [(belt_half, base), (side, z), (-side, z), (-belt_half, base)]
        rings.append([(x, y, height) for y, height in ring])
    rings = np.array(rings)
    cabin = parts.loft(rings, color=plan.paint, caps=False)

    front = np.array([rings[0, 3], rings[0, 0], rings[1, 1], rings[1, 2]])[[1, 0, 3, 2]]
    back = np.array([rings[4, 3], rings[4, 0], rings[3, 1], rings[3, 2]])
    glass = [_make_pane(front, 0.05, 0.08, 0.94), _make_pane(back, 0.07, 0.2, 0.9)]
    for window in _side_windows(plan, base, xs, tops):
        corners = [(x, half_at(z) + 0.012, z) for x, z in window]
        glass += parts.mirror([parts.panel(corners, color=parts.GLASS)])
    return [cabin, *glass]


def _make_pane(corners, near, low, high):
    """Glass in a quad [4, 3] (bottom left, bottom right, top right, top left).

    From a share of its width to as far from the other side, and between two shares of
    its height; just outside of it.
    """
    a, b, c, d = corners

    def place(s, t):
        return (1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * d + s * c)

    normal = np.cross(c - a, d - b)
    normal /= np.linalg.norm(normal)
    far = 1 - near
    quad = [place(near, low), place(far, low), place(far, high), place(near, high)]
    return parts.panel(np.array(quad) - 0.012 * normal, color=parts.GLASS)


def _side_windows(plan, base, xs, tops):
    """Corners (x, z) of the side windows, pillars left between them."""
    low = base + 0.06
    high = min(tops[1], tops[3]) - 0.07

    def on_edge(first, second, z):
        share = (z - tops[first]) / (tops[second] - tops[first])
        return xs[first] + share * (xs[second] - xs[first])

    front_low, front_high = on_edge(0, 1, low) - 0.08, on_edge(0, 1, high) - 0.08
    rear_low, rear_high = on_edge(4, 3, low) + 0.10, on_edge(4, 3, high) + 0.10
    span = front_high - rear_high
    count = WINDOWS.get(plan.style, 2)
    if plan.style == "pickup" and span < 1.3:
        count = 1
    edges = np.linspace(front_high, rear_high, count + 1)
    pillar = 0.045
    windows = []
    for i in range(count):
        a_high = edges[i] - (pillar if i else 0.0)
        b_high = edges[i + 1] + (pillar if i < count - 1 else 0.0)
        a_low = front_low if i == 0 else a_high
        b_low = rear_low if i == count - 1 else b_high
        windows.append([(a_low, low), (b_low, low), (b_high, high), (a_high, high)])
    return windows
