"""Details of procedural cars: wheels, lamps, mirrors, beds, spoilers, racks."""

import functools

import numpy as np

from dpc_jax.shapes import building_blocks as parts
from dpc_jax.shapes.building_blocks import Part
from dpc_jax.shapes.car_plans import Plan


def half_width(plan: Plan, x: float) -> float:
    """Half width of the body at x: narrower at the nose than at the tail."""
    t = 2.0 * x / plan.length  # 1 at the front bumper, -1 at the rear
    front, rear = 0.20 * max(t, 0.0) ** 5, 0.10 * max(-t, 0.0) ** 7
    return plan.half * (1.0 - front - rear)


def deck_height(plan: Plan) -> float:
    """Height of the body behind the cabin: luggage deck, or floor of a pickup's bed."""
    if plan.style == "pickup":
        return plan.floor + 0.45 * (plan.belt - plan.floor)
    return plan.belt * (0.97 if plan.style == "sedan" else 0.95)


def make_wheels(plan: Plan, rng: np.random.Generator) -> list[Part]:
    """Tyres with rims of a plan's axles, on both sides."""
    width = rng.uniform(0.19, 0.25)
    rim_color = parts.CHROME if rng.uniform() < 0.75 else (70, 70, 74)
    pieces = []
    for axle in plan.axles:
        outer = half_width(plan, axle) - 0.005
        centre = np.array([axle, 0.0, plan.wheel])
        ends = centre + [0, outer - width, 0], centre + [0, outer, 0]
        pieces.append(parts.tube(*ends, plan.wheel, color=parts.BLACK, sides=16))
        hub = 0.62 * plan.wheel * parts.circle(12)
        disc = np.column_stack([hub[:, 0], np.full(12, outer + 0.008), hub[:, 1]])
        pieces.append(parts.panel(disc + centre, color=rim_color))
    return parts.mirror(pieces)


def make_lamps(plan: Plan, rng: np.random.Generator) -> list[Part]:
    """Head and tail lamps, grille and number plate."""
    front, rear = plan.length / 2, -plan.length / 2
    yellow = (255, 244, 205) if rng.uniform() < 0.7 else (255, 215, 120)
    low = plan.floor + 0.55 * (plan.nose - plan.floor)
    half = half_width(plan, front)
    size = rng.uniform(0.25, 0.4)
    head = parts.box(
        (front - 0.20, half * (1 - size), low),
        (front + 0.015, half * 1.02, low + 0.16),
        color=yellow,
    )
    grille = parts.box(
        (front - 0.1, -half * 0.5, low - 0.06),
        (front + 0.02, half * 0.5, low + 0.1),
        color=parts.BLACK,
    )
    half = half_width(plan, rear)
    top = plan.belt if plan.style != "sports" else 0.9 * plan.belt
    tall = rng.uniform(0.3, 0.5) if plan.style in ("van", "suv", "wagon") else 0.15
    wide = 0.25 if tall > 0.2 else rng.uniform(0.3, 0.6)
    tail = parts.box(
        (rear - 0.015, half * (1 - wide), top - 0.10 - tall),
        (rear + 0.12, half * 0.985, top - 0.10),
        color=(200, 16, 24),
    )
    plate = parts.box(
        (rear - 0.012, -0.26, plan.floor + 0.32),
        (rear + 0.05, 0.26, plan.floor + 0.43),
        color=(235, 235, 220),
    )
    return [*parts.mirror([head, tail]), grille, plate]


def make_extras(plan: Plan, rng: np.random.Generator) -> list[Part]:
    """Mirrors, a pickup's bed, and sometimes a spoiler or a roof rack."""
    painted = functools.partial(parts.box, color=plan.paint)
    x, z = plan.cowl - 0.18, plan.belt + 0.04
    reach = plan.half + rng.uniform(0.08, 0.16)
    pieces = parts.mirror(
        [painted((x - 0.1, 0.85 * plan.half, z), (x, reach, z + 0.13))]
    )
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
        post = parts.box(
            (rear + 0.1, 0.5 * plan.half, plan.belt - 0.15),
            (rear + 0.18, 0.54 * plan.half, z),
            color=parts.BLACK,
        )
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
