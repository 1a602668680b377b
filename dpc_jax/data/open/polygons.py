"""Polygons in space, cut into triangles."""

import numpy as np


def split_quads(quads: np.ndarray, vertices: np.ndarray) -> list[np.ndarray]:
    """Two triangles for each of the quads [Q, 4, 3] (index, u, v).

    They are cut along the diagonal that lies inside, all at once because most surfaces
    have four corners.
    """
    a, b, c, d = np.moveaxis(vertices[quads[..., 0].astype(int)], 1, 0)
    first = np.cross(b - a, c - a), np.cross(c - a, d - a)
    bad = np.einsum("qc,qc->q", *first) < 0
    order = np.where(bad[:, None], [1, 2, 3, 1, 3, 0], [0, 1, 2, 0, 2, 3])
    corners = np.take_along_axis(quads, order[..., None], axis=1)
    return list(corners.reshape(-1, 3, 3))


def split_polygon(corners: np.ndarray) -> list[tuple[int, int, int]]:
    """Triangles of a polygon [K, 3] in space, as triples of indices.

    A convex one is split into a fan. One with dents is cut ear by ear, because a fan
    would reach outside of it.
    """
    count = len(corners)
    if count < 4:
        return [(0, 1, 2)] if count == 3 else []
    edges = np.roll(corners, -1, axis=0) - corners
    turns = np.cross(np.roll(edges, 1, axis=0), edges)
    spokes = corners - corners[0]
    normal = np.cross(spokes, np.roll(spokes, -1, axis=0)).sum(axis=0)  # Newell
    if (turns @ normal >= -1e-9 * (normal @ normal)).all():
        return [(0, i, i + 1) for i in range(1, count - 1)]
    return _cut_ears(corners, normal)


def _cut_ears(corners, normal):
    axis = int(np.argmax(np.abs(normal)))  # along it the polygon is seen best
    flat = np.delete(corners, axis, axis=1)
    flat = flat * (np.sign(normal[axis]) * (-1 if axis == 1 else 1), 1)

    def side(a, b, c):
        (ax, ay), (bx, by), (cx, cy) = flat[a], flat[b], flat[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    triangles: list[tuple[int, int, int]] = []
    left = list(range(len(corners)))
    while len(left) > 3:
        for place in range(len(left)):
            ear = left[place - 1], left[place], left[(place + 1) % len(left)]
            a, b, c = ear
            inside = (
                side(a, b, i) >= 0 and side(b, c, i) >= 0 and side(c, a, i) >= 0
                for i in left
                if i not in ear
            )
            if side(*ear) > 0 and not any(inside):
                break
        else:
            place = 0  # it crosses itself, so any cut will do
            ear = left[-1], left[0], left[1]
        triangles.append(ear)
        del left[place]
    return [*triangles, (left[0], left[1], left[2])]
