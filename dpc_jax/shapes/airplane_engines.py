"""Engines and gear of procedural airplanes."""

import numpy as np

from dpc_jax.shapes import building_blocks as parts


def wing_lead(plan, share):
    """Leading edge of the wing at a share of the half span."""
    return np.array(
        [
            0.5 - plan.place - share * plan.sweep * plan.span,
            share * plan.span,
            plan.height * plan.radius + share * plan.dihedral * plan.span,
        ]
    )


def make_engines(plan, rng):
    """Under the wings, at the tail, a propeller, or one or two nozzles."""
    r = plan.radius
    if plan.kind == "airliner":
        shares = (0.32,) if rng.uniform() < 0.72 else (0.28, 0.56)
        size = rng.uniform(0.42, 0.6) * r if len(shares) == 1 else 0.38 * r
        pieces = []
        for share in shares:
            lead = wing_lead(plan, share)
            centre = lead - [0.0, 0.0, 1.25 * size]
            pieces += make_nacelle(centre + [0.06, 0, 0], 0.12, size, plan.accent)
            pieces.append(
                parts.bar(
                    centre + [0.0, 0, 0.4 * size],
                    lead - [0.05, 0, 0],
                    width=0.008,
                    height=0.05,
                    color=plan.body,
                )
            )
        return parts.mirror(pieces)
    if plan.kind == "bizjet":
        centre = np.array([-0.2, 1.75 * r, 0.5 * r])
        pod = make_nacelle(centre, 0.14, rng.uniform(0.42, 0.52) * r, plan.accent)
        post = parts.bar(
            centre - [0.05, r, 0],
            centre - [0.05, 0, 0],
            width=0.07,
            height=0.012,
            color=plan.body,
        )
        return parts.mirror([*pod, post])
    if plan.kind == "light":
        reach = rng.uniform(0.13, 0.17)
        turn = rng.uniform(0, np.pi)
        blade = reach * np.array([0.0, np.cos(turn), np.sin(turn)])
        hub = np.array([0.515, 0, -0.1 * r])
        spinner = parts.tube(
            (0.5, 0, -0.1 * r),
            (0.54, 0, -0.1 * r),
            0.25 * r,
            radius_stop=0.02 * r,
            color=plan.accent,
        )
        blades = parts.bar(
            hub - blade, hub + blade, width=0.02, height=0.008, color=parts.BLACK
        )
        return [spinner, blades]
    side = 0.0 if rng.uniform() < 0.4 else 0.6 * r
    nozzle = parts.tube(
        (-0.48, side, 0),
        (-0.53, side, 0),
        0.62 * r,
        radius_stop=0.5 * r,
        color=parts.BLACK,
        sides=10,
    )
    intake = parts.box(
        (-0.05, 1.0 * r, -0.5 * r), (0.16, 1.5 * r, 0.4 * r), color=plan.body
    )
    return [*(parts.mirror([nozzle]) if side else [nozzle]), *parts.mirror([intake])]


def make_nacelle(front, length, radius, color):
    """Engine pod: its open front is a dark disc."""
    front = np.asarray(front, float)
    ring = parts.circle(10)
    rings = []
    for share, size in ((0.0, 0.85), (0.15, 1.0), (0.6, 0.95), (1.0, 0.55)):
        offset = np.column_stack([np.full(10, -share * length), radius * size * ring])
        rings.append(front + offset)
    disc = parts.panel(
        front + [0.001, 0, 0] + np.column_stack([np.zeros(10), 0.75 * radius * ring]),
        color=parts.BLACK,
    )
    return [parts.loft(rings, color=color), disc]


def make_gear(plan):
    """Fixed gear of a light airplane: two main wheels and one at the nose."""
    low = -plan.radius - 0.09
    main = np.array([0.08, 0.15, low])
    pieces = parts.mirror(
        [
            parts.tube(
                (0.08, 0.4 * plan.radius, -0.8 * plan.radius),
                main,
                0.008,
                color=plan.body,
                sides=6,
            ),
            parts.tube(
                main - [0, 0.012, 0], main + [0, 0.012, 0], 0.03, color=parts.BLACK
            ),
        ]
    )
    nose = np.array([0.38, 0.0, low])
    strut = parts.tube(
        (0.38, 0, -0.5 * plan.radius), nose, 0.008, color=plan.body, sides=6
    )
    wheel = parts.tube(
        nose - [0, 0.01, 0], nose + [0, 0.01, 0], 0.026, color=parts.BLACK
    )
    return [*pieces, strut, wheel]
