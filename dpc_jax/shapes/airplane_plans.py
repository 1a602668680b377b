"""Measures of procedural airplanes: four kinds and the ranges they are drawn from."""

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
