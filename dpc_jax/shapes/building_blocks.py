"""Building blocks of the procedural shapes: coloured lofts, boxes, panels.

A list of parts joins to one mesh. Nearly everything is a loft: rings of points along a
path, skinned with triangles. Lengths are metres, z is up.
"""

import colorsys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import trimesh

from dpc_jax.shapes.normalization import join_pieces

Color = tuple[int, ...]  # r, g, b in 0..255

BLACK = (18, 18, 20)
GLASS = (32, 40, 52)
CHROME = (190, 195, 200)


class Part(NamedTuple):
    """A piece of one colour: vertices [N, 3], faces [F, 3]."""

    vertices: np.ndarray
    faces: np.ndarray
    color: Color


def loft(rings: npt.ArrayLike, *, color: Color, caps: bool = True) -> Part:
    """Skin over rings [S, R, 3] of R points each; with caps both ends are closed."""
    rings = np.asarray(rings, dtype=np.float64)
    stations, around, _ = rings.shape
    index = np.arange(stations * around).reshape(stations, around)
    a, b = index[:-1], np.roll(index[:-1], -1, axis=1)
    c, d = index[1:], np.roll(index[1:], -1, axis=1)
    faces = [np.stack(half, -1).reshape(-1, 3) for half in ((a, b, d), (a, d, c))]
    vertices = rings.reshape(-1, 3)
    if caps:
        for ring, centre in ((index[0, ::-1], rings[0]), (index[-1], rings[-1])):
            middle = np.full(around, len(vertices))
            vertices = np.concatenate([vertices, centre.mean(axis=0, keepdims=True)])
            faces.append(np.stack([middle, ring, np.roll(ring, -1)], -1))
    return Part(vertices, np.concatenate(faces), color)


def circle(count: int) -> np.ndarray:
    """Corners [count, 2] of a regular polygon in the unit circle."""
    angle = (np.arange(count) + 0.5) * 2.0 * np.pi / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def tube(
    start: npt.ArrayLike,
    stop: npt.ArrayLike,
    radius: float,
    *,
    color: Color,
    radius_stop: float | None = None,
    sides: int = 8,
) -> Part:
    """Cylinder, or cone where `radius_stop` differs, between two points."""
    start, stop = np.asarray(start, float), np.asarray(stop, float)
    axis = (stop - start) / np.linalg.norm(stop - start)
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    side = np.cross(axis, helper)
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(axis, side)])
    ring = circle(sides) @ frame
    end = radius if radius_stop is None else radius_stop
    return loft([start + radius * ring, stop + end * ring], color=color)


def wheel(
    centre: npt.ArrayLike,
    radius: float,
    *,
    sides: tuple[float, float],
    rim: tuple[float, float],
    color: Color,
) -> list[Part]:
    """Tyre between two places along y, and the disc of its rim: its place, its radius.

    They are counted from the centre [3] of the axle.
    """
    centre = np.asarray(centre, float)
    start, stop = (centre + [0.0, side, 0.0] for side in sides)
    place, size = rim
    hub = size * circle(12)
    disc = centre + np.column_stack([hub[:, 0], np.full(12, place), hub[:, 1]])
    tyre = tube(start, stop, radius, color=BLACK, sides=16)
    return [tyre, panel(disc, color=color)]


def box(low: Sequence[float], high: Sequence[float], *, color: Color) -> Part:
    """Axis-aligned box between two corners."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    square = np.array([[y0, z0], [y1, z0], [y1, z1], [y0, z1]])
    rings = [np.column_stack([np.full(4, x), square]) for x in (x0, x1)]
    return loft(rings, color=color)


def bar(
    start: npt.ArrayLike,
    stop: npt.ArrayLike,
    *,
    width: float,
    height: float,
    color: Color,
) -> Part:
    """Beam of rectangular section between two points; width along y where possible."""
    start, stop = np.asarray(start, float), np.asarray(stop, float)
    axis = (stop - start) / np.linalg.norm(stop - start)
    across = np.array([0.0, 1.0, 0.0]) if abs(axis[1]) < 0.9 else np.array([1.0, 0, 0])
    across -= axis * (across @ axis)
    across /= np.linalg.norm(across)
    upright = np.cross(axis, across)
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2.0
    ring = square @ np.stack([width * across, height * upright])
    return loft([start + ring, stop + ring], color=color)


def panel(corners: npt.ArrayLike, *, color: Color) -> Part:
    """Flat convex polygon from its corners [K, 3]: a window, a lamp, a stripe."""
    corners = np.asarray(corners, dtype=np.float64)
    last = np.arange(2, len(corners))
    faces = np.stack([np.zeros_like(last), last - 1, last], axis=-1)
    return Part(corners, faces, color)


def mirror(parts: Sequence[Part]) -> list[Part]:
    """The parts and their mirror images at the xz plane (left and right)."""
    images = [Part(v * [1.0, -1.0, 1.0], f[:, ::-1], color) for v, f, color in parts]
    return [*parts, *images]


def join(parts: Sequence[Part]) -> trimesh.Trimesh:
    """One mesh with face colours; triangles without area are left out."""
    pieces = []
    for v, f, color in parts:
        colors = np.tile(np.array([*color, 255], np.uint8), (len(f), 1))
        pieces.append((v, f, colors))
    vertices, faces, colors = join_pieces(pieces)
    normals = trimesh.triangles.cross(vertices[faces])
    keep = np.linalg.norm(normals, axis=-1) > 1e-10
    return trimesh.Trimesh(
        vertices, faces[keep], face_colors=colors[keep], process=False
    )


def draw_color(
    rng: np.random.Generator,
    *,
    saturation: tuple[float, float],
    value: tuple[float, float],
) -> Color:
    """Random (r, g, b): any hue, saturation and value uniform in the given ranges."""
    hue = rng.uniform(0.0, 6.0) / 6.0
    rgb = colorsys.hsv_to_rgb(hue, rng.uniform(*saturation), rng.uniform(*value))
    return tuple(round(255.0 * channel) for channel in rgb)
