"""What a procedural chair stands on: legs, star, sled, pedestal, plinth."""

import numpy as np

from dpc_jax.shapes import building_blocks as parts


def make_legs(plan, rng):
    """Four legs, splayed or straight, now and then with stretchers."""
    radius, splay = rng.uniform(0.012, 0.024), rng.uniform(0.0, 0.16)
    square = rng.uniform() < 0.4
    x, y = 0.43 * plan.depth, 0.42 * plan.width
    top = plan.seat - plan.thick
    pieces = []
    for sign in (1, -1):
        start = np.array([sign * x, y, top])
        foot = np.array([sign * (x + splay * 0.4), y + splay * 0.3, 0.0])
        if square:
            leg = parts.bar(
                start, foot, width=2 * radius, height=2 * radius, color=plan.frame_color
            )
        else:
            leg = parts.tube(
                start,
                foot,
                1.15 * radius,
                radius_stop=0.75 * radius,
                color=plan.frame_color,
                sides=8,
            )
        pieces.append(leg)
    if rng.uniform() < 0.45 or top > 0.55:
        height = rng.uniform(0.25, 0.45)
        reach = splay * (1 - height)
        z = top * height
        side = y + 0.3 * reach
        pieces.append(
            parts.tube(
                (x + 0.4 * reach, side, z),
                (-x - 0.4 * reach, side, z),
                0.7 * radius,
                color=plan.frame_color,
                sides=6,
            )
        )
        for sign in (1, -1):
            end = sign * (x + 0.4 * reach)
            pieces.append(
                parts.tube(
                    (end, -1e-3, z),
                    (end, side, z),
                    0.7 * radius,
                    color=plan.frame_color,
                    sides=6,
                )
            )
    return parts.mirror(pieces)


def make_star(plan, rng):
    """Gas spring on a star of four or five feet with castors."""
    count, reach = int(rng.choice([4, 5])), rng.uniform(0.26, 0.33)
    top = plan.seat - plan.thick
    pieces = [parts.tube((0, 0, 0.1), (0, 0, top), 0.028, color=plan.frame_color)]
    turn = rng.uniform(0.0, 2 * np.pi)
    for angle in turn + 2 * np.pi * np.arange(count) / count:
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        foot = reach * out + [0, 0, 0.07]
        pieces.append(
            parts.tube(
                (0, 0, 0.12),
                foot,
                0.028,
                radius_stop=0.016,
                color=plan.frame_color,
                sides=6,
            )
        )
        side = 0.02 * np.cross(out, [0, 0, 1])
        hub = reach * out + [0, 0, 0.032]
        pieces.append(parts.tube(hub - side, hub + side, 0.032, color=parts.BLACK))
    return pieces


def make_sled(plan, rng):
    """Bent tube on each side; the cantilever has no rear leg."""
    radius = rng.uniform(0.011, 0.016)
    x, y, top = 0.46 * plan.depth, 0.46 * plan.width, plan.seat - plan.thick
    path = [(x, top), (x + rng.uniform(0, 0.05), radius), (-x, radius)]
    if rng.uniform() < 0.5:
        path.append((-x, top))
    pieces = [
        parts.tube((a[0], y, a[1]), (b[0], y, b[1]), radius, color=plan.frame_color)
        for a, b in zip(path[:-1], path[1:], strict=True)
    ]
    pieces.append(
        parts.tube(
            (-x, -1e-3, radius),
            (-x, y, radius),
            radius,
            color=plan.frame_color,
            sides=6,
        )
    )
    return parts.mirror(pieces)


def make_pedestal(plan, rng):
    """One column on a round or trumpet-shaped foot."""
    radius, top = rng.uniform(0.17, 0.24), plan.seat - plan.thick
    neck = rng.uniform(0.02, 0.035)
    heights = np.array([0.0, 0.02, 0.05, 0.3 * top, top])
    radii = np.array([radius, radius, rng.uniform(0.3, 0.8) * radius, neck, neck])
    ring = parts.circle(14)
    rings = [
        np.column_stack([r * ring, np.full(len(ring), z)])
        for r, z in zip(radii, heights, strict=True)
    ]
    return [parts.loft(rings, color=plan.frame_color)]


def make_block(plan, rng):
    """Upholstered plinth of an armchair, on short feet."""
    foot = rng.uniform(0.05, 0.14)
    x, y = 0.5 * plan.depth, 0.48 * plan.width
    plinth = parts.box(
        (-x, -y, foot), (0.96 * x, y, plan.seat - plan.thick), color=plan.seat_color
    )
    feet = [
        parts.tube(
            (s * 0.85 * x, 0.85 * y, 0),
            (s * 0.85 * x, 0.85 * y, foot),
            0.02,
            radius_stop=0.03,
            color=plan.frame_color,
        )
        for s in (1, -1)
    ]
    return [plinth, *parts.mirror(feet)]
