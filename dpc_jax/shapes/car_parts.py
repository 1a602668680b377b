"""Measures of procedural cars: their body styles and the ranges they are drawn from.

Lengths along the car are written as shares of its length from the front bumper, as a
designer's side view is read: bonnet, windscreen, roof, rear window, deck.

Made from these: wheels, lamps, mirrors, beds, spoilers, racks.
"""

import functools
from types import SimpleNamespace

import numpy as np

from dpc_jax.shapes import building_blocks as parts
from dpc_jax.shapes.building_blocks import Part

# ranges: length, width, height, clearance, wheel radius (metres); cowl, windscreen run,
# roof end, rear window run (shares of the length); belt line, nose (shares of height);
# share of the cabin's width that the roof keeps. Typical of cars on the road.
STYLES = {
    "sedan": dict(length=(4.4, 5.0), width=(1.75, 1.88), height=(1.40, 1.50),
                  clearance=(0.14, 0.18), wheel=(0.30, 0.34), cowl=(0.26, 0.31),
                  rake=(0.11, 0.15), roof_end=(0.64, 0.70), tail=(0.11, 0.15),
                  belt=(0.60, 0.66), nose=(0.44, 0.50), roof=(0.74, 0.80)),
    "hatchback": dict(length=(3.6, 4.3), width=(1.62, 1.80), height=(1.42, 1.56),
                      clearance=(0.14, 0.18), wheel=(0.28, 0.33), cowl=(0.22, 0.27),
                      rake=(0.12, 0.17), roof_end=(0.84, 0.90), tail=(0.06, 0.09),
                      belt=(0.58, 0.65), nose=(0.43, 0.50), roof=(0.76, 0.83)),
    "wagon": dict(length=(4.5, 4.95), width=(1.75, 1.88), height=(1.44, 1.54),
                  clearance=(0.14, 0.19), wheel=(0.30, 0.34), cowl=(0.25, 0.29),
                  rake=(0.11, 0.14), roof_end=(0.88, 0.93), tail=(0.04, 0.06),
                  belt=(0.60, 0.65), nose=(0.44, 0.50), roof=(0.76, 0.82)),
    "suv": dict(length=(4.3, 5.0), width=(1.80, 2.00), height=(1.64, 1.88),
                clearance=(0.20, 0.28), wheel=(0.36, 0.42), cowl=(0.24, 0.29),
                rake=(0.08, 0.11), roof_end=(0.87, 0.93), tail=(0.03, 0.07),
                belt=(0.60, 0.66), nose=(0.50, 0.57), roof=(0.78, 0.86)),
    "van": dict(length=(4.5, 5.4), width=(1.80, 2.00), height=(1.85, 2.25),
                clearance=(0.17, 0.22), wheel=(0.31, 0.36), cowl=(0.11, 0.17),
                rake=(0.11, 0.15), roof_end=(0.955, 0.975), tail=(0.012, 0.02),
                belt=(0.50, 0.57), nose=(0.38, 0.44), roof=(0.84, 0.92)),
    "pickup": dict(length=(4.9, 5.7), width=(1.80, 2.00), height=(1.72, 1.92),
                   clearance=(0.22, 0.30), wheel=(0.36, 0.42), cowl=(0.24, 0.28),
                   rake=(0.07, 0.10), roof_end=(0.48, 0.60), tail=(0.015, 0.03),
                   belt=(0.58, 0.63), nose=(0.50, 0.56), roof=(0.78, 0.84)),
    "sports": dict(length=(4.1, 4.6), width=(1.80, 1.98), height=(1.14, 1.30),
                   clearance=(0.10, 0.14), wheel=(0.31, 0.35), cowl=(0.33, 0.40),
                   rake=(0.14, 0.18), roof_end=(0.62, 0.68), tail=(0.20, 0.27),
                   belt=(0.62, 0.68), nose=(0.42, 0.48), roof=(0.68, 0.75)),
    "city": dict(length=(2.5, 3.1), width=(1.45, 1.62), height=(1.42, 1.60),
                 clearance=(0.14, 0.18), wheel=(0.27, 0.31), cowl=(0.16, 0.22),
                 rake=(0.16, 0.22), roof_end=(0.84, 0.92), tail=(0.05, 0.08),
                 belt=(0.56, 0.62), nose=(0.44, 0.50), roof=(0.78, 0.86)),
    "limousine": dict(length=(5.8, 7.8), width=(1.80, 1.95), height=(1.42, 1.52),
                      clearance=(0.14, 0.18), wheel=(0.31, 0.35), cowl=(0.18, 0.22),
                      rake=(0.07, 0.10), roof_end=(0.76, 0.82), tail=(0.06, 0.09),
                      belt=(0.60, 0.66), nose=(0.44, 0.50), roof=(0.76, 0.82)),
    "convertible": dict(length=(3.8, 4.8), width=(1.70, 1.90), height=(1.25, 1.42),
                        clearance=(0.12, 0.16), wheel=(0.30, 0.34), cowl=(0.30, 0.38),
                        rake=(0.07, 0.11), roof_end=(0.62, 0.70), tail=(0.05, 0.08),
                        belt=(0.58, 0.66), nose=(0.42, 0.50), roof=(0.80, 0.86)),
    "transporter": dict(length=(5.2, 7.0), width=(1.95, 2.10), height=(2.40, 2.85),
                        clearance=(0.20, 0.26), wheel=(0.34, 0.38), cowl=(0.10, 0.15),
                        rake=(0.08, 0.12), roof_end=(0.965, 0.98), tail=(0.008, 0.015),
                        belt=(0.44, 0.50), nose=(0.34, 0.40), roof=(0.88, 0.95)),
    "bus": dict(length=(7.5, 12.0), width=(2.30, 2.55), height=(2.70, 3.30),
                clearance=(0.28, 0.36), wheel=(0.44, 0.50), cowl=(0.02, 0.04),
                rake=(0.05, 0.09), roof_end=(0.97, 0.98), tail=(0.008, 0.015),
                belt=(0.40, 0.46), nose=(0.30, 0.36), roof=(0.90, 0.97)),
    "double_decker": dict(length=(8.0, 11.0), width=(2.40, 2.55), height=(3.90, 4.40),
                          clearance=(0.28, 0.36), wheel=(0.44, 0.50), cowl=(0.02, 0.04),
                          rake=(0.04, 0.08), roof_end=(0.97, 0.98), tail=(0.008, 0.015),
                          belt=(0.28, 0.33), nose=(0.22, 0.26), roof=(0.92, 0.98)),
}  # fmt: skip
# Shares of `car_simple`: what most people drive.
SIMPLE_SHARES = {"sedan": 0.22, "hatchback": 0.19, "wagon": 0.11, "suv": 0.17,
                 "van": 0.1, "pickup": 0.1, "sports": 0.11}  # fmt: skip
# Of `car`: as different as what stands in a street.
SHARES = {"sedan": 0.09, "hatchback": 0.09, "wagon": 0.05, "suv": 0.09, "van": 0.06,
          "pickup": 0.09, "sports": 0.06, "city": 0.08, "limousine": 0.05,
          "convertible": 0.06, "transporter": 0.05, "bus": 0.06, "double_decker": 0.04,
          "truck": 0.09, "three_wheeler": 0.04}  # fmt: skip
# Windows along a side, of styles that have more or fewer than two.
WINDOWS = {"sports": 1, "city": 1, "transporter": 1, "van": 3, "wagon": 3, "suv": 3,
           "limousine": 4, "bus": 7, "double_decker": 6}  # fmt: skip
# Shares of the length where the axles are, front and rear.
_FRONT_AXLE = {"van": (0.15, 0.19), "bus": (0.19, 0.24), "double_decker": (0.17, 0.22)}
_REAR_AXLE = {"pickup": (0.74, 0.79), "bus": (0.68, 0.76), "double_decker": (0.7, 0.77)}


def draw_plan(rng: np.random.Generator, style: str) -> SimpleNamespace:
    """Draw the measures, in metres, of a car of one of `STYLES`."""
    m = {key: rng.uniform(*span) for key, span in STYLES[style].items()}
    length, height = m["length"], m["height"]

    def place(share):
        return length * (0.5 - share)

    front_axle = rng.uniform(*_FRONT_AXLE.get(style, (0.165, 0.2)))
    rear_axle = rng.uniform(*_REAR_AXLE.get(style, (0.79, 0.83)))
    return SimpleNamespace(
        style=style,
        length=length,
        half=m["width"] / 2,
        roof_half=m["roof"] * m["width"] / 2,
        height=height,
        floor=m["clearance"],
        wheel=m["wheel"],
        axles=(place(front_axle), place(rear_axle)),
        cowl=place(m["cowl"]),
        roof_front=place(m["cowl"] + m["rake"]),
        roof_rear=place(m["roof_end"]),
        tail=place(m["roof_end"] + m["tail"]),
        belt=m["belt"] * height,
        nose=m["nose"] * height,
        paint=draw_paint(rng),
    )


def draw_paint(rng: np.random.Generator) -> parts.Color:
    """White, silver, grey or black for half of all cars, as on the road."""
    if rng.uniform() < 0.5:
        grey = rng.choice([45, 75, 120, 165, 195, 220])
        return tuple(int(c) for c in np.clip(grey + rng.integers(-8, 9, 3), 0, 255))
    return parts.draw_color(rng, saturation=(0.55, 1.0), value=(0.4, 0.95))


def half_width(plan: SimpleNamespace, x: float) -> float:
    """Half width of the body at x: narrower at the nose than at the tail."""
    t = 2.0 * x / plan.length  # 1 at the front bumper, -1 at the rear
    front, rear = 0.20 * max(t, 0.0) ** 5, 0.10 * max(-t, 0.0) ** 7
    return plan.half * (1.0 - front - rear)


def deck_height(plan: SimpleNamespace) -> float:
    """Height of the body behind the cabin: luggage deck, or floor of a pickup's bed."""
    if plan.style == "pickup":
        return plan.floor + 0.45 * (plan.belt - plan.floor)
    return plan.belt * (0.97 if plan.style == "sedan" else 0.95)


def make_wheels(plan: SimpleNamespace, rng: np.random.Generator) -> list[Part]:
    """Tyres with rims of a plan's axles, on both sides."""
    width = rng.uniform(0.19, 0.25)
    rim_color = parts.CHROME if rng.uniform() < 0.75 else (70, 70, 74)
    pieces = []
    for axle in plan.axles:
        centre, outer = (axle, 0.0, plan.wheel), half_width(plan, axle) - 0.005
        sides, rim = (outer - width, outer), (outer + 0.008, 0.62 * plan.wheel)
        pieces += parts.wheel(centre, plan.wheel, sides=sides, rim=rim, color=rim_color)
    return parts.mirror(pieces)


def make_lamps(plan: SimpleNamespace, rng: np.random.Generator) -> list[Part]:
    """Head and tail lamps, grille and number plate."""
    front, rear = plan.length / 2, -plan.length / 2
    yellow = (255, 244, 205) if rng.uniform() < 0.7 else (255, 215, 120)
    low = plan.floor + 0.55 * (plan.nose - plan.floor)
    half = half_width(plan, front)
    size = rng.uniform(0.25, 0.4)
    inner, outer = half * (1 - size), half * 1.02
    corners = (front - 0.20, inner, low), (front + 0.015, outer, low + 0.16)
    head = parts.box(*corners, color=yellow)
    wide = half * 0.5
    corners = (front - 0.1, -wide, low - 0.06), (front + 0.02, wide, low + 0.1)
    grille = parts.box(*corners, color=parts.BLACK)
    half = half_width(plan, rear)
    top = plan.belt if plan.style != "sports" else 0.9 * plan.belt
    tall = rng.uniform(0.3, 0.5) if plan.style in ("van", "suv", "wagon") else 0.15
    wide = 0.25 if tall > 0.2 else rng.uniform(0.3, 0.6)
    low_corner = (rear - 0.015, half * (1 - wide), top - 0.10 - tall)
    corners = low_corner, (rear + 0.12, half * 0.985, top - 0.10)
    tail = parts.box(*corners, color=(200, 16, 24))
    low, high = plan.floor + 0.32, plan.floor + 0.43
    corners = (rear - 0.012, -0.26, low), (rear + 0.05, 0.26, high)
    plate = parts.box(*corners, color=(235, 235, 220))
    return [*parts.mirror([head, tail]), grille, plate]


def make_extras(plan: SimpleNamespace, rng: np.random.Generator) -> list[Part]:
    """Mirrors, a pickup's bed, and sometimes a spoiler or a roof rack."""
    painted = functools.partial(parts.box, color=plan.paint)
    x, z = plan.cowl - 0.18, plan.belt + 0.04
    reach = plan.half + rng.uniform(0.08, 0.16)
    mirror = painted((x - 0.1, 0.85 * plan.half, z), (x, reach, z + 0.13))
    pieces = parts.mirror([mirror])
    rear = -plan.length / 2
    if plan.style == "pickup":
        deck, wall = deck_height(plan) - 0.05, plan.belt * 0.98
        half = 0.9 * half_width(plan, rear)
        side = painted((rear, half - 0.07, deck), (plan.tail, half + 0.06, wall))
        gate = painted((rear, -half, deck), (rear + 0.07, half, wall))
        pieces += [*parts.mirror([side]), gate]
    if plan.style == "sports" and rng.uniform() < 0.6:
        z, half = plan.belt + rng.uniform(0.12, 0.3), 0.85 * plan.half
        wing = painted((rear, -half, z), (rear + 0.28, half, z + 0.04))
        low_corner = (rear + 0.1, 0.5 * plan.half, plan.belt - 0.15)
        corners = low_corner, (rear + 0.18, 0.54 * plan.half, z)
        post = parts.box(*corners, color=parts.BLACK)
        pieces += [wing, *parts.mirror([post])]
    if plan.style in ("hatchback", "suv") and rng.uniform() < 0.4:
        x, z, half = plan.roof_rear, plan.height - 0.09, 0.9 * plan.roof_half
        pieces.append(painted((x - 0.22, -half, z), (x + 0.1, half, z + 0.035)))
    if plan.style in ("wagon", "suv", "van") and rng.uniform() < 0.35:
        y, z = 0.85 * plan.roof_half, plan.height + 0.05
        ends = (plan.roof_front - 0.15, y, z), (plan.roof_rear + 0.1, y, z)
        rail = parts.bar(*ends, width=0.04, height=0.11, color=parts.BLACK)
        pieces += parts.mirror([rail])
    return pieces
