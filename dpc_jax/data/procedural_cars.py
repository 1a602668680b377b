"""Procedural cars of seven body styles, in metres, z up, front towards +x."""

import numpy as np

from . import procedural_parts as parts
from .procedural_car_plans import draw_plan


def make_car(rng):
    """Mesh of a random car (`trimesh.Trimesh`, metres, not normalised)."""
    plan = draw_plan(rng)
    pieces = [*_make_body(plan, rng), *_make_cabin(plan), *_make_wheels(plan, rng)]
    pieces += _make_lamps(plan, rng)
    pieces += _make_extras(plan, rng)
    return parts.join(pieces)


def _deck_height(plan):
    """Height of the body behind the cabin: luggage deck, or floor of a pickup's bed."""
    if plan.style == "pickup":
        return plan.floor + 0.45 * (plan.belt - plan.floor)
    return plan.belt * (0.97 if plan.style == "sedan" else 0.95)


def _half_width(plan, x):
    """Half width of the body at x: narrower at the nose than at the tail."""
    t = 2.0 * x / plan.length  # 1 at the front bumper, -1 at the rear
    front, rear = 0.20 * max(t, 0.0) ** 5, 0.10 * max(-t, 0.0) ** 7
    return plan.half * (1.0 - front - rear)


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
    deck = _deck_height(plan)
    rim = plan.floor + 0.86 * (deck - plan.floor)
    top_x = [rear, rear + 0.025 * plan.length, plan.tail - 0.05, plan.tail,
             plan.cowl, front - 0.10 * plan.length, front - 0.03 * plan.length, front]
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
        half = _half_width(plan, x)
        shoulder = high - 0.22 * (high - low)
        waist = low + 0.25 * (high - low)
        right = [(0.95 * half, low), (half, waist), (0.985 * half, shoulder),
                 (0.90 * half, high)]
        ring = [*right, *((-y, z) for y, z in reversed(right))]
        rings.append([(x, y, z) for y, z in ring])
    body = parts.loft(rings, color=plan.paint)
    front, rear = plan.length / 2, -plan.length / 2
    inner = plan.half - 0.26
    under = parts.box(
        (rear + 0.25, -inner, plan.floor + 0.02),
        (front - 0.25, inner, plan.floor + 0.36 * (plan.belt - plan.floor)),
        color=parts.BLACK,
    )
    trim = parts.BLACK if rng.uniform() < 0.5 else parts.CHROME
    bumpers = []
    for end, sign in ((front, 1), (rear, -1)):
        half = 0.96 * _half_width(plan, end)
        low = plan.floor + 0.10
        x = sorted((end - sign * 0.10, end + sign * 0.04))
        bumpers.append(
            parts.box((x[0], -half, low), (x[1], half, low + 0.14), color=trim)
        )
    return [body, under, *bumpers]


def _make_cabin(plan):
    """Greenhouse with tumblehome, and its windows just outside of it."""
    base = plan.belt - 0.02
    belt_half = 0.89 * plan.half
    crown = 0.025 * plan.height
    xs = np.array([plan.cowl, plan.roof_front,
                   0.5 * (plan.roof_front + plan.roof_rear), plan.roof_rear, plan.tail])
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

    front = np.array([rings[0, 3], rings[0, 0], rings[1, 1], rings[1, 2]])[
        [1, 0, 3, 2]
    ]
    back = np.array([rings[4, 3], rings[4, 0], rings[3, 1], rings[3, 2]])
    glass = [
        parts.panel(
            parts.inset(front, left=0.05, right=0.05, bottom=0.08, top=0.06, lift=-0.012),
            color=parts.GLASS,
        ),
        parts.panel(
            parts.inset(back, left=0.07, right=0.07, bottom=0.2, top=0.1, lift=-0.012),
            color=parts.GLASS,
        ),
    ]
    for window in _side_windows(plan, base, xs, tops):
        corners = [(x, half_at(z) + 0.012, z) for x, z in window]
        glass += parts.mirror([parts.panel(corners, color=parts.GLASS)])
    return [cabin, *glass]


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
    count = {"sports": 1, "pickup": 2, "van": 3, "wagon": 3, "suv": 3}.get(plan.style, 2)
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


def _make_wheels(plan, rng):
    width = rng.uniform(0.19, 0.25)
    rim_color = parts.CHROME if rng.uniform() < 0.75 else (70, 70, 74)
    pieces = []
    for axle in plan.axles:
        outer = _half_width(plan, axle) - 0.005
        centre = np.array([axle, 0.0, plan.wheel])
        pieces.append(
            parts.tube(
                centre + [0, outer - width, 0], centre + [0, outer, 0], plan.wheel,
                color=parts.BLACK, sides=16,
            )
        )
        hub = 0.62 * plan.wheel * parts.circle(12)
        disc = np.column_stack([hub[:, 0], np.full(12, outer + 0.008), hub[:, 1]])
        pieces.append(parts.panel(disc + centre, color=rim_color))
    return parts.mirror(pieces)


def _make_lamps(plan, rng):
    front, rear = plan.length / 2, -plan.length / 2
    yellow = (255, 244, 205) if rng.uniform() < 0.7 else (255, 215, 120)
    low = plan.floor + 0.55 * (plan.nose - plan.floor)
    half = _half_width(plan, front)
    size = rng.uniform(0.25, 0.4)
    head = parts.box(
        (front - 0.20, half * (1 - size), low),
        (front + 0.015, half * 1.02, low + 0.16), color=yellow,
    )
    grille = parts.box(
        (front - 0.1, -half * 0.5, low - 0.06), (front + 0.02, half * 0.5, low + 0.1),
        color=parts.BLACK,
    )
    half = _half_width(plan, rear)
    top = plan.belt if plan.style != "sports" else 0.9 * plan.belt
    tall = rng.uniform(0.3, 0.5) if plan.style in ("van", "suv", "wagon") else 0.15
    wide = 0.25 if tall > 0.2 else rng.uniform(0.3, 0.6)
    tail = parts.box(
        (rear - 0.015, half * (1 - wide), top - 0.10 - tall),
        (rear + 0.12, half * 0.985, top - 0.10), color=(200, 16, 24),
    )
    plate = parts.box(
        (rear - 0.012, -0.26, plan.floor + 0.32), (rear + 0.05, 0.26, plan.floor + 0.43),
        color=(235, 235, 220),
    )
    return [*parts.mirror([head, tail]), grille, plate]


def _make_extras(plan, rng):
    """Mirrors, a pickup's bed, and now and then a spoiler or a roof rack."""
    pieces = []
    x, z = plan.cowl - 0.18, plan.belt + 0.04
    reach = plan.half + rng.uniform(0.08, 0.16)
    outside = parts.box((x - 0.1, 0.85 * plan.half, z), (x, reach, z + 0.13),
                        color=plan.paint)
    pieces += parts.mirror([outside])
    rear = -plan.length / 2
    if plan.style == "pickup":
        deck, wall = _deck_height(plan), plan.belt * 0.98
        half = 0.9 * _half_width(plan, rear)
        side = parts.box((rear, half - 0.07, deck - 0.05), (plan.tail, half + 0.06, wall),
                         color=plan.paint)
        gate = parts.box((rear, -half, deck - 0.05), (rear + 0.07, half, wall),
                         color=plan.paint)
        pieces += [*parts.mirror([side]), gate]
    if plan.style == "sports" and rng.uniform() < 0.6:
        z = plan.belt + rng.uniform(0.12, 0.3)
        wing = parts.box((rear, -0.85 * plan.half, z), (rear + 0.28, 0.85 * plan.half,
                         z + 0.04), color=plan.paint)
        post = parts.box((rear + 0.1, 0.5 * plan.half, plan.belt - 0.15),
                         (rear + 0.18, 0.54 * plan.half, z), color=parts.BLACK)
        pieces += [wing, *parts.mirror([post])]
    if plan.style in ("hatchback", "suv") and rng.uniform() < 0.4:
        z = plan.height - 0.09
        x = plan.roof_rear
        pieces.append(parts.box((x - 0.22, -0.9 * plan.roof_half, z),
                                (x + 0.1, 0.9 * plan.roof_half, z + 0.035),
                                color=plan.paint))
    if plan.style in ("wagon", "suv", "van") and rng.uniform() < 0.35:
        y = 0.85 * plan.roof_half
        z = plan.height + 0.05
        rail = parts.bar((plan.roof_front - 0.15, y, z), (plan.roof_rear + 0.1, y, z),
                         width=0.04, height=0.11, color=parts.BLACK)
        pieces += parts.mirror([rail])
    return pieces
