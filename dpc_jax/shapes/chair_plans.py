"""Measures of procedural chairs and the ranges they are drawn from."""

from typing import NamedTuple

import numpy as np

from dpc_jax.shapes.building_blocks import BLACK, CHROME, Color, draw_color

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
    frame_color: Color
    seat_color: Color


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
        frame_color = [BLACK, CHROME, (90, 92, 96)][rng.integers(3)]
    else:
        frame_color = WOODS[rng.integers(len(WOODS))]
    fabric = draw_color(rng, saturation=(0.3, 0.95), value=(0.3, 0.9))
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
