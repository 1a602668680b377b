"""Procedural airplanes of four kinds, one fuselage long, z up, nose towards +x."""

import functools

import numpy as np
import trimesh

from dpc_jax.shapes import building_blocks as parts
from dpc_jax.shapes.airplane_parts import draw_plan, make_engines, make_gear, wing_lead

UPPER = np.array([1.0, 0.5])  # chords of a fin, shares of the lower one


def make_airplane(rng: np.random.Generator) -> trimesh.Trimesh:
    """Mesh of a random airplane, one fuselage long, not normalised.

    Its labels are body, wing, tail, engine and gear.
    """
    plan = draw_plan(rng)
    groups = [("body", _make_fuselage(plan, rng)), ("wing", _make_wings(plan))]
    groups += [("tail", _make_tail(plan, rng)), ("engine", make_engines(plan, rng))]
    gear = make_gear(plan) if plan.kind == "light" else []
    return parts.join([*groups, ("gear", gear)])


def _make_fuselage(plan, rng):
    """Rings along the axis; the tail rises, so that belly and back differ."""
    r = plan.radius
    if plan.kind == "fighter":
        x = [0.5, 0.44, 0.36, 0.24, 0.05, -0.2, -0.42, -0.5]
        size = [0.04, 0.3, 0.58, 0.85, 1.0, 1.05, 0.9, 0.72]
        rise = [-0.2, -0.1, 0, 0, 0, 0, 0, 0]
        flat = 1.35
    elif plan.kind == "light":
        x = [0.5, 0.47, 0.3, 0.2, 0.0, -0.14, -0.3, -0.5]
        size = [0.45, 0.62, 0.85, 1.0, 1.0, 0.75, 0.42, 0.16]
        rise = [-0.1, -0.1, -0.05, 0, 0, 0.12, 0.25, 0.35]
        flat = 0.85
    else:
        nose = rng.uniform(0.9, 1.2)
        x = [0.5, 0.49, 0.47, 0.43, 0.5 - 0.11 * nose, 0.1, -0.15, -0.3, -0.42, -0.5]
        size = [0.08, 0.35, 0.6, 0.86, 1.0, 1.0, 1.0, 0.82, 0.45, 0.14]
        rise = [-0.28, -0.26, -0.18, -0.06, 0, 0, 0, 0.14, 0.42, 0.6]
        flat = 1.0
    ring = parts.circle(14)
    rings = [
        np.column_stack(
            [np.full(len(ring), a), s * r * flat * ring[:, 0], r * (s * ring[:, 1] + b)]
        )
        for a, s, b in zip(x, size, rise, strict=True)
    ]
    pieces = [parts.loft(rings, color=plan.body)]
    if plan.kind in ("airliner", "bizjet"):
        pieces += _make_windows(plan)
    else:
        pieces.append(_make_canopy(plan))
    return pieces


def _make_windows(plan):
    """A dark windscreen around the nose and a stripe of windows along each side."""
    r = plan.radius
    scale = np.array([1, r, r])
    pane = [
        (0.468, 0.16, 0.44),
        (0.432, 0.66, 0.44),
        (0.428, 0.5, 0.8),
        (0.455, 0.14, 0.68),
    ]
    stripe = [
        (0.36, 1.005, 0.18),
        (-0.2, 1.005, 0.18),
        (-0.2, 0.985, 0.36),
        (0.36, 0.985, 0.36),
    ]
    windscreen = parts.panel(pane * scale, color=parts.GLASS)
    return parts.mirror([windscreen, parts.panel(stripe * scale, color=plan.accent)])


def _make_canopy(plan):
    """Glass bubble over the cockpit of a fighter, or cabin of a light airplane."""
    r = plan.radius
    if plan.kind == "fighter":
        x, size, base = [0.36, 0.30, 0.22, 0.1], [0.05, 0.5, 0.55, 0.05], 0.5
        tall = 1.0
    else:
        x, size, base = [0.26, 0.18, 0.02, -0.1], [0.3, 0.8, 0.85, 0.3], 0.35
        tall = 0.62 if plan.height > 0 else 0.9
    y, z = parts.circle(10).T
    rings = [
        np.column_stack([a + 0 * y, s * r * y, r * (base + tall * s * z)])
        for a, s in zip(x, size, strict=True)
    ]
    return parts.loft(rings, color=parts.GLASS)


def _foil(lead, chord, *, color, thick=0.11, upright=False):
    """Wing or fin of symmetric sections with leading edges `lead` [S, 3]."""
    outline = np.array([[0, 0], [0.12, 0.4], [0.45, 0.5], [1, 0.02],
                        [1, -0.02], [0.45, -0.5], [0.12, -0.4]])  # fmt: skip
    rings = []
    for start, length in zip(np.asarray(lead, float), chord, strict=True):
        ring = np.zeros((len(outline), 3)) + start
        ring[:, 0] -= length * outline[:, 0]
        ring[:, 1 if upright else 2] += thick * length * outline[:, 1]
        rings.append(ring)
    return parts.loft(rings, color=color)


_fin = functools.partial(_foil, thick=0.1, upright=True)


def _make_wings(plan):
    thick = 0.05 if plan.kind == "fighter" else 0.12
    chords = np.array([1.0, plan.taper]) * plan.root
    lead = [wing_lead(plan, share) for share in (0.0, 1.0)]
    wing = [_foil(lead, chords, color=plan.body, thick=thick)]
    if plan.kind in ("airliner", "bizjet") and plan.taper > 0.28:  # winglet
        tip = lead[1]
        top = tip + [-0.045, 0.012, 0.05]
        wing.append(_fin([tip, top], chords[1] * UPPER, color=plan.accent))
    if plan.kind == "light" and plan.height > 0:  # strut of a high wing
        start = wing_lead(plan, 0.45) - [0.35 * plan.root, 0, 0]
        foot = np.array([start[0], 0.7 * plan.radius, -0.7 * plan.radius])
        wing.append(parts.tube(foot, start, 0.006, color=plan.accent, sides=6))
    return parts.mirror(wing)


def _make_tail(plan, rng):
    """Fin and stabiliser: low, T-shaped (bizjets) or twin fins (some fighters)."""
    tee = plan.kind == "bizjet" or (plan.kind == "airliner" and rng.uniform() < 0.12)
    twin = plan.kind == "fighter" and rng.uniform() < 0.55
    rise = rng.uniform(0.13, 0.18) if plan.kind != "light" else rng.uniform(0.12, 0.16)
    chord = rng.uniform(0.13, 0.17)
    sweep = rng.uniform(0.06, 0.12) if plan.kind != "light" else rng.uniform(0.03, 0.06)
    base = 0.3 * plan.radius if plan.kind != "fighter" else 0.6 * plan.radius
    start = np.array([-0.5 + chord + 0.01, 0.0, base])
    tip = start + [-sweep, 0.0, rise]
    if twin:
        lean = rng.uniform(0.0, 0.35) * rise
        side = np.array([0.0, 0.85 * plan.radius, 0.0])
        lead = [start + side, tip + side + [0, lean, 0]]
        fin = _fin(lead, [chord, 0.45 * chord], color=plan.body, thick=0.07)
        pieces = parts.mirror([fin])
    else:
        pieces = [_fin([start, tip], chord * UPPER, color=plan.accent)]
    half = rng.uniform(0.14, 0.2)
    root = tip - [0.01, 0, 0.01] if tee else start + [-0.02, 0, 0.1 * plan.radius]
    if plan.kind == "fighter":
        root = np.array([-0.36, 0.9 * plan.radius, plan.height * plan.radius])
    end = root + [-rng.uniform(0.3, 0.6) * half * (plan.kind != "light"), half, 0.01]
    chords = [0.6 * chord, 0.35 * chord] if tee else [0.75 * chord, 0.4 * chord]
    stabiliser = _foil([root, end], chords, color=plan.body, thick=0.09)
    return [*pieces, *parts.mirror([stabiliser])]
