"""Measures of procedural airplanes, four kinds with their ranges; engines and gear."""

import functools
from typing import NamedTuple

import numpy as np

from dpc_jax.shapes import building_blocks as parts

KINDS = ("airliner", "bizjet", "light", "fighter")
KIND_SHARES = (0.4, 0.2, 0.2, 0.2)


class Plan(NamedTuple):
    """Measures of one airplane, all in fuselage lengths (the mesh is rescaled)."""

    kind: str
    radius: float  # of the fuselage
    span: float  # half span
    root: float  # chord of the wing at the fuselage
    taper: float  # tip chord / root chord
    sweep: float  # run of the leading edge per half span
    dihedral: float  # rise per half span
    place: float  # leading edge at the root, share of the length from the nose
    height: float  # of the wing, in fuselage radii
    body: parts.Color
    accent: parts.Color


def draw_plan(rng: np.random.Generator) -> Plan:
    """Draw the kind and the measures of an airplane."""
    kind = str(rng.choice(KINDS, p=KIND_SHARES))
    ranges = {
        "airliner": dict(radius=(0.046, 0.066), span=(0.42, 0.54), root=(0.16, 0.22),
                         taper=(0.22, 0.35), sweep=(0.45, 0.65), dihedral=(0.06, 0.12),
                         place=(0.34, 0.40), height=(-0.7, -0.4)),
        "bizjet": dict(radius=(0.05, 0.065), span=(0.38, 0.52), root=(0.15, 0.2),
                       taper=(0.3, 0.45), sweep=(0.2, 0.5), dihedral=(0.03, 0.08),
                       place=(0.40, 0.47), height=(-0.8, -0.5)),
        "light": dict(radius=(0.06, 0.085), span=(0.58, 0.75), root=(0.17, 0.23),
                      taper=(0.6, 1.0), sweep=(-0.02, 0.08), dihedral=(0.02, 0.09),
                      place=(0.24, 0.31), height=(-0.8, 0.95)),
        "fighter": dict(radius=(0.045, 0.06), span=(0.28, 0.38), root=(0.34, 0.46),
                        taper=(0.1, 0.3), sweep=(0.7, 1.0), dihedral=(-0.05, 0.04),
                        place=(0.36, 0.44), height=(-0.3, 0.4)),
    }[kind]  # fmt: skip
    measures = {key: rng.uniform(*span) for key, span in ranges.items()}
    if kind == "light":  # high or low wing, nothing between
        measures["height"] = float(rng.choice([-0.75, 0.92]))
    if kind == "fighter":
        grey = rng.uniform(70, 170) * np.array([1.0, 1.0, rng.uniform(0.85, 1.1)])
        body = tuple(int(c) for c in grey)
    elif rng.uniform() < 0.65:
        body = tuple(int(c) for c in rng.integers(185, 226) + rng.integers(-5, 6, 3))
    else:
        body = parts.draw_color(rng, saturation=(0.2, 0.9), value=(0.5, 0.9))
    accent = parts.draw_color(rng, saturation=(0.6, 1.0), value=(0.3, 0.9))
    return Plan(kind=kind, body=body, accent=accent, **measures)


def wing_lead(plan: Plan, share: float) -> np.ndarray:
    """Leading edge [3] of the wing at a share of the half span."""
    return np.array(
        [
            0.5 - plan.place - share * plan.sweep * plan.span,
            share * plan.span,
            plan.height * plan.radius + share * plan.dihedral * plan.span,
        ]
    )


def make_engines(plan: Plan, rng: np.random.Generator) -> list[parts.Part]:
    """Under the wings, at the tail, a propeller, or one or two nozzles."""
    makers = {
        "airliner": _make_wing_engines,
        "bizjet": _make_tail_engines,
        "light": _make_propeller,
        "fighter": _make_nozzles,
    }
    return makers[plan.kind](plan, rng)


def _make_wing_engines(plan, rng):
    shares = (0.32,) if rng.uniform() < 0.72 else (0.28, 0.56)
    size = plan.radius * (rng.uniform(0.42, 0.6) if len(shares) == 1 else 0.38)
    pieces = []
    for share in shares:
        lead = wing_lead(plan, share)
        centre = lead - [0.0, 0.0, 1.25 * size]
        pieces += _make_nacelle(centre + [0.06, 0, 0], 0.12, size, plan.accent)
        ends = centre + [0.0, 0, 0.4 * size], lead - [0.05, 0, 0]
        pieces.append(parts.bar(*ends, width=0.008, height=0.05, color=plan.body))
    return parts.mirror(pieces)


def _make_tail_engines(plan, rng):
    r = plan.radius
    centre = np.array([-0.2, 1.75 * r, 0.5 * r])
    pod = _make_nacelle(centre, 0.14, rng.uniform(0.42, 0.52) * r, plan.accent)
    ends = centre - [0.05, r, 0], centre - [0.05, 0, 0]
    return parts.mirror(
        [*pod, parts.bar(*ends, width=0.07, height=0.012, color=plan.body)]
    )


def _make_propeller(plan, rng):
    r, z = plan.radius, -0.1 * plan.radius
    reach = rng.uniform(0.13, 0.17)
    turn = rng.uniform(0, np.pi)
    blade = reach * np.array([0.0, np.cos(turn), np.sin(turn)])
    hub = np.array([0.515, 0, z])
    ends, last = ((0.5, 0, z), (0.54, 0, z)), 0.02 * r
    spinner = parts.tube(*ends, 0.25 * r, radius_stop=last, color=plan.accent)
    return [
        spinner,
        parts.bar(
            hub - blade, hub + blade, width=0.02, height=0.008, color=parts.BLACK
        ),
    ]


def _make_nozzles(plan, rng):
    r = plan.radius
    side = 0.0 if rng.uniform() < 0.4 else 0.6 * r
    ends, last = ((-0.48, side, 0), (-0.53, side, 0)), 0.5 * r
    nozzle = [
        parts.tube(*ends, 0.62 * r, radius_stop=last, color=parts.BLACK, sides=10)
    ]
    intake = parts.box(
        (-0.05, 1.0 * r, -0.5 * r), (0.16, 1.5 * r, 0.4 * r), color=plan.body
    )
    return [*(parts.mirror(nozzle) if side else nozzle), *parts.mirror([intake])]


def _make_nacelle(front, length, radius, color):
    """Engine pod: its open front is a dark disc."""
    front = np.asarray(front, float)
    ring = parts.circle(10)
    rings = []
    for share, size in ((0.0, 0.85), (0.15, 1.0), (0.6, 0.95), (1.0, 0.55)):
        offset = np.column_stack([np.full(10, -share * length), radius * size * ring])
        rings.append(front + offset)
    disc = np.column_stack([np.zeros(10), 0.75 * radius * ring])
    return [
        parts.loft(rings, color=color),
        parts.panel(front + [0.001, 0, 0] + disc, color=parts.BLACK),
    ]


def make_gear(plan: Plan) -> list[parts.Part]:
    """Fixed gear of a light airplane: two main wheels and one at the nose."""
    r, low = plan.radius, -plan.radius - 0.09
    strut = functools.partial(parts.tube, radius=0.008, color=plan.body, sides=6)
    main, nose = np.array([0.08, 0.15, low]), np.array([0.38, 0.0, low])

    def wheel(centre, half_width, radius):
        side = np.array([0, half_width, 0])
        return parts.tube(centre - side, centre + side, radius, color=parts.BLACK)

    legs = [strut((0.08, 0.4 * r, -0.8 * r), main), wheel(main, 0.012, 0.03)]
    return [
        *parts.mirror(legs),
        strut((0.38, 0, -0.5 * r), nose),
        wheel(nose, 0.01, 0.026),
    ]
