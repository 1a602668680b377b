"""Procedural airplanes of four kinds, one fuselage long, z up, nose towards +x."""

import functools
from types import SimpleNamespace

import numpy as np
import trimesh

from dpc_jax.shapes import building_blocks as parts

_KINDS = ("airliner", "bizjet", "light", "fighter")
_SHARES = (0.4, 0.2, 0.2, 0.2)
_UPPER = np.array([1.0, 0.5])  # chords of a fin, shares of the lower one


def _draw_plan(rng: np.random.Generator) -> SimpleNamespace:
    """Draw the kind and the measures of an airplane, in lengths of the fuselage.

    Of the wing, span is half of it, root the chord at the fuselage, taper tip chord by
    root chord, sweep and dihedral run and rise per half span, place where the leading
    edge begins behind the nose, and height is in radii of the fuselage.
    """
    kind = str(rng.choice(_KINDS, p=_SHARES))
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
    return SimpleNamespace(kind=kind, body=body, accent=accent, **measures)


def _wing_lead(plan, share):
    """Leading edge [3] of the wing at a share of the half span."""
    x = 0.5 - plan.place - share * plan.sweep * plan.span
    z = plan.height * plan.radius + share * plan.dihedral * plan.span
    return np.array([x, share * plan.span, z])


def make_airplane(rng: np.random.Generator) -> trimesh.Trimesh:
    """Mesh of a random airplane, one fuselage long, not normalised."""
    plan = _draw_plan(rng)
    engines = {
        "airliner": _make_wing_engines,
        "bizjet": _make_tail_engines,
        "light": _make_propeller,
        "fighter": _make_nozzles,
    }
    pieces = [*_make_fuselage(plan, rng), *_make_wings(plan), *_make_tail(plan, rng)]
    pieces += engines[plan.kind](plan, rng)
    return parts.join(pieces + (_make_gear(plan) if plan.kind == "light" else []))


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
    pane = [(0.468, 0.16, 0.44), (0.432, 0.66, 0.44)]
    pane += [(0.428, 0.5, 0.8), (0.455, 0.14, 0.68)]
    stripe = [(0.36, 1.005, 0.18), (-0.2, 1.005, 0.18)]
    stripe += [(-0.2, 0.985, 0.36), (0.36, 0.985, 0.36)]
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
    lead = [_wing_lead(plan, share) for share in (0.0, 1.0)]
    wing = [_foil(lead, chords, color=plan.body, thick=thick)]
    if plan.kind in ("airliner", "bizjet") and plan.taper > 0.28:  # winglet
        tip = lead[1]
        top = tip + [-0.045, 0.012, 0.05]
        wing.append(_fin([tip, top], chords[1] * _UPPER, color=plan.accent))
    if plan.kind == "light" and plan.height > 0:  # strut of a high wing
        start = _wing_lead(plan, 0.45) - [0.35 * plan.root, 0, 0]
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
        pieces = [_fin([start, tip], chord * _UPPER, color=plan.accent)]
    half = rng.uniform(0.14, 0.2)
    root = tip - [0.01, 0, 0.01] if tee else start + [-0.02, 0, 0.1 * plan.radius]
    if plan.kind == "fighter":
        root = np.array([-0.36, 0.9 * plan.radius, plan.height * plan.radius])
    end = root + [-rng.uniform(0.3, 0.6) * half * (plan.kind != "light"), half, 0.01]
    chords = [0.6 * chord, 0.35 * chord] if tee else [0.75 * chord, 0.4 * chord]
    stabiliser = _foil([root, end], chords, color=plan.body, thick=0.09)
    return [*pieces, *parts.mirror([stabiliser])]


def _make_wing_engines(plan, rng):
    shares = (0.32,) if rng.uniform() < 0.72 else (0.28, 0.56)
    size = plan.radius * (rng.uniform(0.42, 0.6) if len(shares) == 1 else 0.38)
    pieces = []
    for share in shares:
        lead = _wing_lead(plan, share)
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
    pylon = parts.bar(*ends, width=0.07, height=0.012, color=plan.body)
    return parts.mirror([*pod, pylon])


def _make_propeller(plan, rng):
    r, z = plan.radius, -0.1 * plan.radius
    reach = rng.uniform(0.13, 0.17)
    turn = rng.uniform(0, np.pi)
    blade = reach * np.array([0.0, np.cos(turn), np.sin(turn)])
    hub = np.array([0.515, 0, z])
    ends, last = ((0.5, 0, z), (0.54, 0, z)), 0.02 * r
    spinner = parts.tube(*ends, 0.25 * r, radius_stop=last, color=plan.accent)
    ends = hub - blade, hub + blade
    return [spinner, parts.bar(*ends, width=0.02, height=0.008, color=parts.BLACK)]


def _make_nozzles(plan, rng):
    r = plan.radius
    side = 0.0 if rng.uniform() < 0.4 else 0.6 * r
    ends, last = ((-0.48, side, 0), (-0.53, side, 0)), 0.5 * r
    tube = functools.partial(parts.tube, color=parts.BLACK, sides=10)
    nozzle = [tube(*ends, 0.62 * r, radius_stop=last)]
    corners = (-0.05, 1.0 * r, -0.5 * r), (0.16, 1.5 * r, 0.4 * r)
    intake = parts.mirror([parts.box(*corners, color=plan.body)])
    return [*(parts.mirror(nozzle) if side else nozzle), *intake]


def _make_nacelle(front, length, radius, color):
    """Engine pod: its open front is a dark disc."""
    front = np.asarray(front, float)
    ring = parts.circle(10)
    rings = []
    for share, size in ((0.0, 0.85), (0.15, 1.0), (0.6, 0.95), (1.0, 0.55)):
        offset = np.column_stack([np.full(10, -share * length), radius * size * ring])
        rings.append(front + offset)
    disc = np.column_stack([np.zeros(10), 0.75 * radius * ring])
    disc = parts.panel(front + [0.001, 0, 0] + disc, color=parts.BLACK)
    return [parts.loft(rings, color=color), disc]


def _make_gear(plan):
    """Fixed gear of a light airplane: two main wheels and one at the nose."""
    r, low = plan.radius, -plan.radius - 0.09
    strut = functools.partial(parts.tube, radius=0.008, color=plan.body, sides=6)
    main, nose = np.array([0.08, 0.15, low]), np.array([0.38, 0.0, low])

    def wheel(centre, half_width, radius):
        side = np.array([0, half_width, 0])
        return parts.tube(centre - side, centre + side, radius, color=parts.BLACK)

    legs = [strut((0.08, 0.4 * r, -0.8 * r), main), wheel(main, 0.012, 0.03)]
    middle = [strut((0.38, 0, -0.5 * r), nose), wheel(nose, 0.01, 0.026)]
    return [*parts.mirror(legs), *middle]
