"""Procedural trucks and three-wheelers, in metres, z up, front towards +x.

A truck is a cab on a chassis with what it carries: a box, a tank, a dump body, or a
platform with goods. One in four pulls a long trailer. A three-wheeler has a single
front wheel and a canopy on posts.
"""

import numpy as np

from dpc_jax.shapes import building_blocks as parts
from dpc_jax.shapes.building_blocks import Part

_STEEL = (110, 112, 116)
_LAMP, _REAR_LAMP = (255, 244, 205), (200, 16, 24)


def make_truck(rng: np.random.Generator, paint: parts.Color) -> list[Part]:
    """Parts of a truck: chassis, cab, wheels, and its load."""
    half, wheel = rng.uniform(1.05, 1.25), rng.uniform(0.42, 0.52)
    has_trailer = rng.uniform() < 0.25
    length = rng.uniform(9.5, 13.5) if has_trailer else rng.uniform(4.8, 8.5)
    front, rear = length / 2, -length / 2
    floor = 1.9 * wheel
    hood = rng.uniform(0.9, 1.4) if rng.uniform() < 0.4 else 0.0
    cab_rear = front - hood - rng.uniform(1.5, 2.3)
    top = rng.uniform(2.3, 3.0)
    cab = _make_cab(front, cab_rear, hood, (half, floor, top), paint)
    load = _make_load((rear, cab_rear - 0.15), half, floor + 0.12, top, rng)
    axles = [front - 0.55 - 0.5 * hood]
    behind = rear + rng.uniform(0.7, 0.12 * length + 0.6)
    axles += [behind + 1.15 * i for i in range(3 if has_trailer else 1)]
    if has_trailer:
        axles.append(cab_rear - 0.2)
    elif length > 7 and rng.uniform() < 0.6:
        axles.append(behind + 1.15)
    wheels = [part for x in axles for part in _make_wheel(x, half, wheel)]
    frame = (rear, -0.45, floor - 0.25), (front - 0.3, 0.45, floor)
    body = [parts.box(*frame, color=_STEEL), *_make_ends(front, rear, half, floor)]
    return [*body, *cab, *parts.mirror(wheels), *load]


def _make_prism(profile, half, *, color):
    """A side view (x, z), seen from its middle, as wide as 2 · half."""
    rings = [[(x, y, z) for x, z in profile] for y in (half, -half)]
    return parts.loft(rings, color=color)


def _make_cab(front, rear, hood, sizes, paint):
    """A cab with its windows; the engine is under it, or in a hood before it."""
    half, floor, top = sizes
    low, waist = floor - 0.35, floor + 0.45 * (top - floor)
    screen = front - hood
    profile = [(rear, low), (screen, low), (screen, waist), (screen - 0.3, top)]
    cab = [_make_prism([*profile, (rear, top)], half, color=paint)]
    if hood:
        nose = [(screen, low), (front, low), (front, waist - 0.3), (screen, waist)]
        cab.append(_make_prism(nose, 0.8 * half, color=paint))
    glass_low, glass_high = waist + 0.05, top - 0.15

    def slope(z):
        return screen - 0.3 * (z - waist) / (top - waist) + 0.012

    wide = 0.9 * half
    corners = [(slope(z), y, z) for z, y in (
        (glass_low, -wide), (glass_low, wide), (glass_high, wide), (glass_high, -wide),
    )]  # fmt: skip
    cab.append(parts.panel(corners, color=parts.GLASS))
    back = rear + 0.35 * (screen - rear)
    window = [(slope(glass_low) - 0.2, glass_low), (back, glass_low)]
    window += [(back, glass_high), (slope(glass_high) - 0.2, glass_high)]
    side = [(x, half + 0.012, z) for x, z in window]
    mirror = (screen - 0.15, half, waist), (screen - 0.05, half + 0.25, waist + 0.4)
    pieces = [parts.panel(side, color=parts.GLASS)]
    pieces.append(parts.box(*mirror, color=parts.BLACK))
    return [*cab, *parts.mirror(pieces)]


def _make_ends(front, rear, half, floor):
    """Bumpers, lamps and grille."""
    low = floor - 0.4
    bumper = (front - 0.15, -half, low - 0.1), (front + 0.05, half, low + 0.1)
    wide = 0.5 * half
    grille = (front - 0.1, -wide, low + 0.15), (front + 0.02, wide, low + 0.5)
    under = (rear, -half, floor - 0.3), (rear + 0.1, half, floor - 0.15)
    # Wrapped round the corners, so that they are seen from the side too.
    side = 1.02 * half
    head = (front - 0.3, wide, low + 0.1), (front + 0.05, side, low + 0.55)
    tail = (rear - 0.05, 0.4 * half, floor - 0.2), (rear + 0.3, side, floor + 0.3)
    lamps = [parts.box(*head, color=_LAMP), parts.box(*tail, color=_REAR_LAMP)]
    dark = [parts.box(*corners, color=parts.BLACK) for corners in (bumper, grille)]
    return [*dark, parts.box(*under, color=_STEEL), *parts.mirror(lamps)]


def _make_wheel(x, half, radius):
    centre, sides = (x, 0.0, radius), (half - 0.35, half - 0.02)
    rim = (half - 0.01, 0.55 * radius)
    return parts.wheel(centre, radius, sides=sides, rim=rim, color=parts.CHROME)


def _make_load(span, half, low, cab_top, rng):
    """What a truck carries on its frame between two stations x, from a height on."""
    rear, front = span
    color = parts.draw_color(rng, saturation=(0.0, 0.9), value=(0.5, 0.95))
    kinds = ["box", "tank", "dump", "goods", "empty"]
    kind = rng.choice(kinds, p=[0.4, 0.15, 0.15, 0.2, 0.1])
    deck = parts.box((rear, -half, low - 0.12), (front, half, low), color=_STEEL)
    if kind == "box":
        high = max(low + 1.2, cab_top + rng.uniform(-0.3, 0.9))
        return [parts.box((rear, -half, low - 0.12), (front, half, high), color=color)]
    if kind == "tank":
        radius = rng.uniform(0.7, 0.95) * half
        ends = (rear, 0.0, low + radius), (front, 0.0, low + radius)
        return [parts.tube(*ends, radius, color=color, sides=16), deck]
    walls = rng.uniform(0.5, 1.2) if kind == "dump" else 0.35
    wall = parts.box((rear, half - 0.08, low), (front, half, low + walls), color=color)
    board = (front - 0.08, -half, low), (front, half, max(low + walls, cab_top - 0.2))
    load = [deck, *parts.mirror([wall]), parts.box(*board, color=color)]
    if kind == "dump":
        heap = [(rear, low), (front, low), (front, low + walls)]
        heap += [((rear + front) / 2, low + walls + 0.45), (rear, low + walls)]
        return [*load, _make_prism(heap, half - 0.1, color=(120, 96, 70))]
    if kind == "goods":
        load += pile_goods((rear, front - 0.1), half - 0.12, low, rng)
    return load


def pile_goods(
    span: tuple[float, float], half: float, low: float, rng: np.random.Generator
) -> list[Part]:
    """Boxes, or two layers of pipes, on a platform between two stations x."""
    rear, front = span
    if rng.uniform() < 0.35:
        radius = rng.uniform(0.12, 0.28)
        count = max(2, int(half / radius))
        rows = (np.arange(count) - (count - 1) / 2) * 2 * radius
        layers = (low + radius, rows), (low + 2.7 * radius, rows[:-1] + radius)
        return [
            parts.tube((rear, y, z), (front, y, z), radius, color=_STEEL)
            for z, row in layers
            for y in row
        ]
    goods, x = [], rear
    while x < front - 0.4:
        stop = min(front, x + rng.uniform(0.7, 2.2))
        wide, high = half * rng.uniform(0.7, 1.0), rng.uniform(0.5, 1.7)
        color = parts.draw_color(rng, saturation=(0.2, 0.7), value=(0.4, 0.9))
        corners = (x, -wide, low), (stop - 0.05, wide, low + high)
        goods.append(parts.box(*corners, color=color))
        x = stop + rng.uniform(0, 0.6)
    return goods


def make_three_wheeler(rng: np.random.Generator, paint: parts.Color) -> list[Part]:
    """Parts of a three-wheeler: tub, canopy, wheels, cargo."""
    length, half = rng.uniform(2.4, 3.1), rng.uniform(0.6, 0.75)
    top, wheel = rng.uniform(1.6, 1.9), rng.uniform(0.2, 0.26)
    front, rear, floor = length / 2, -length / 2, 0.22
    waist = floor + rng.uniform(0.45, 0.6)
    stations = [(front, 0.3, waist - 0.1), (front - 0.35, 0.55, waist + 0.1)]
    stations += [(front - 0.8, 0.95, waist), (rear + 0.1, 1.0, waist)]
    stations.append((rear, 0.9, waist))
    rings = []
    for x, share, high in stations:
        y, foot = half * share, 0.9 * half * share
        ring = [(x, foot, floor), (x, y, high), (x, -y, high), (x, -foot, floor)]
        rings.append(ring)
    body = [parts.loft(rings, color=paint)]
    lamp = (front - 0.1, 0, waist), (front + 0.06, 0, waist)
    body.append(parts.tube(*lamp, 0.09, color=_LAMP))
    low, high = (rear - 0.03, 0.6 * half), (rear + 0.05, 0.85 * half)
    tail = parts.box((*low, waist - 0.2), (*high, waist - 0.05), color=_REAR_LAMP)
    body += parts.mirror([tail])
    roof_front = front - rng.uniform(0.5, 0.8)
    canopy = [(rear + 0.05, top - 0.15), (roof_front, top - 0.12)]
    canopy += [(roof_front - 0.3, top), (rear + 0.3, top)]
    cloth = parts.BLACK if rng.uniform() < 0.5 else paint
    cabin = [_make_prism(canopy, half, color=cloth)]
    posts = ((front - 0.6, roof_front - 0.05), (rear + 0.12, rear + 0.12))
    for low_x, high_x in posts:
        ends = (low_x, 0.88 * half, waist - 0.02), (high_x, 0.88 * half, top - 0.12)
        cabin += parts.mirror([parts.tube(*ends, 0.03, color=parts.BLACK, sides=6)])
    screen = [(front - 0.59, y, waist + 0.05) for y in (-0.8 * half, 0.8 * half)]
    screen += [(roof_front - 0.04, y, top - 0.2) for y in (0.8 * half, -0.8 * half)]
    cabin.append(parts.panel(screen, color=parts.GLASS))
    seat = (rear + 0.35, -0.8 * half, waist), (rear + 0.5, 0.8 * half, waist + 0.5)
    load = [parts.box(*seat, color=(70, 50, 40))]
    if rng.uniform() < 0.4:
        crate = (rear + 0.1, -0.7 * half, top), (rear + 0.9, 0.7 * half, top + 0.35)
        load.append(parts.box(*crate, color=(150, 110, 70)))
    wheels = parts.mirror(_make_wheel(rear + 0.35, half, wheel))
    ends = (front - 0.25, -0.08, wheel), (front - 0.25, 0.08, wheel)
    wheels.append(parts.tube(*ends, wheel, color=parts.BLACK, sides=16))
    return [*body, *cabin, *wheels, *load]
