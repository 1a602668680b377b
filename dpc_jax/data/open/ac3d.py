"""Reading AC3D files (.ac, .acc), which trimesh does not know.

AC3D is a text format: materials, then a tree of objects, each with its own offset,
vertices, texture and surfaces. The `.acc` of racing games adds normals, several texture
coordinates per corner, and triangle strips. Lines have no surface and are left out.
"""

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from trimesh.visual.color import uv_to_color

from dpc_jax.data.meshes import MOST_BYTES, find_beside
from dpc_jax.data.sets.pictures import open_picture
from dpc_jax.files import Damage, read_bytes, reading
from dpc_jax.shapes.normalization import join_pieces

GREY = (0.667, 0.667, 0.667)  # of a surface without a material
POLYGON, STRIP = 0, 4  # kinds of surface; 1 and 2 are lines


class Part(NamedTuple):
    """One object of a file: vertices float64 [N, 3] in its frame, faces int [F, 3].

    colors: uint8 [F, 4], material times texture at the middle of the face.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray


def read_parts(path: Path, *, textures: Path | None = None) -> list[Part]:
    """The objects of an AC3D file that have surfaces.

    Textures that are not where the file says are searched by name in the folder
    `textures`, if there is one.
    """
    with reading("an AC3D file", path):
        lines = read_bytes(path, most=MOST_BYTES).decode("latin-1").split("\n")
        if not lines[0].startswith("AC3D"):
            raise Damage("its first line is not AC3D")
        parts = _Reader(lines, path, textures).read_all()
    if not parts:
        raise ValueError(f"Expected surfaces in {path}, but found none; remove it.")
    return parts


def join_parts(parts: Sequence[Part]) -> trimesh.Trimesh:
    """One mesh of several parts, with their colours, made opaque."""
    vertices, faces, colors = join_pieces(
        [(part.vertices, part.faces, part.colors) for part in parts]
    )
    colors[:, 3] = 255
    return trimesh.Trimesh(vertices, faces, face_colors=colors, process=False)


class _Reader:
    """Reads the lines of a file one after the other."""

    def __init__(self, lines, path, textures):
        self._lines = iter(lines)
        self._path, self._textures = path, textures
        self._images, self._materials, self._parts = {}, [], []

    def read_all(self):
        for line in self._lines:
            key, _, rest = line.strip().partition(" ")
            if key == "MATERIAL":
                words = rest.rpartition('"')[2].split()
                color = [float(x) for x in words[words.index("rgb") + 1 :][:3]]
                clear = float(words[words.index("trans") + 1])
                self._materials.append((*color, 1.0 - clear))
            elif key == "OBJECT":
                self._read_object(np.zeros(3), np.eye(3))
        return self._parts

    def _next(self):
        """The next line that is not blank."""
        return next(line for text in self._lines if (line := text.strip()))

    def _read_object(self, place, turn):
        """Read one object and those below it, placed as their parents say."""
        name, texture = "", None
        repeat, offset = np.ones(2), np.zeros(2)
        vertices, surfaces = np.zeros((0, 3)), []
        while True:
            key, _, rest = self._next().partition(" ")
            if key == "name":
                name = rest.strip('" ')
            elif key == "data":
                left = int(rest)
                while left > 0:  # characters, of any number of lines
                    left -= len(next(self._lines)) + 1
            elif key == "texture" and texture is None:  # the first is the base layer
                texture = rest.split('"')[1] if '"' in rest else rest
            elif key == "texrep":
                repeat = _numbers(rest, 2)
            elif key == "texoff":
                offset = _numbers(rest, 2)
            elif key == "loc":
                place = place + _numbers(rest, 3) @ turn
            elif key == "rot":
                turn = _numbers(rest, 9).reshape(3, 3) @ turn
            elif key == "numvert":
                rows = [self._next().split()[:3] for _ in range(int(rest))]
                vertices = np.array(rows, dtype=np.float64).reshape(-1, 3)
            elif key == "numsurf":
                surfaces = [self._read_surface() for _ in range(int(rest))]
            elif key == "kids":
                break
        vertices = vertices @ turn + place
        self._add_part(name, vertices, surfaces, texture, repeat, offset)
        for _ in range(int(rest)):
            # Some files count more objects than they have.
            if any(line.startswith("OBJ") for line in self._lines):
                self._read_object(place, turn)

    def _read_surface(self):
        """(kind, material, corners): corners are lists of index, u, v."""
        kind, material = POLYGON, 0
        while True:
            key, _, rest = self._next().partition(" ")
            if key == "SURF":
                kind = int(rest, 16) & 0xF
            elif key == "mat":
                material = int(rest)
            elif key == "refs":
                break
        corners = [self._next().split()[:3] for _ in range(int(rest))]
        corners = [(int(i), float(u), float(v)) for i, u, v in corners]
        return kind, material, corners

    def _add_part(self, name, vertices, surfaces, texture, repeat, offset):
        triangles, materials = [], []
        for kind, material, corners in surfaces:
            if not all(0 <= corner[0] < len(vertices) for corner in corners):
                raise Damage(f"a surface of {name or 'an object'} lacks a corner")
            found = []
            if kind == POLYGON:
                found = split_polygon(vertices[[corner[0] for corner in corners]])
            elif kind == STRIP:
                found = [(i, i + 1, i + 2) for i in range(len(corners) - 2)]
            triangles += [[corners[i] for i in triangle] for triangle in found]
            materials += [material] * len(found)
        corners = np.array(triangles).reshape(-1, 3, 3)  # [F, 3, 3]: index, u, v
        faces = corners[..., 0].astype(int)
        # strips turn corners by triangles without area, which repeat an index
        whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        if not whole.any():
            return
        known = [*self._materials, (*GREY, 1.0)]
        materials = [m if m < len(self._materials) else -1 for m in materials]
        corners, faces = corners[whole], faces[whole]
        colors = np.array(known)[materials][whole]
        image = self._load_texture(texture)
        if image is not None:
            middle = corners[..., 1:].mean(axis=1) * repeat + offset
            colors = colors * (uv_to_color(middle % 1.0, image) / 255.0)
        colors = np.rint(np.clip(colors, 0.0, 1.0) * 255.0).astype(np.uint8)
        self._parts.append(Part(name, vertices, faces, colors))

    def _load_texture(self, name):
        """A texture, or None if there is none that can be read."""
        if name is None:
            return None
        if name not in self._images:
            self._images[name] = None
            path = find_beside(self._path, name)
            if path is None and self._textures is not None:
                wanted = name.replace("\\", "/").rsplit("/", 1)[-1]
                found = sorted(self._textures.rglob("*"), key=str)
                path = next((p for p in found if p.name == wanted), None)
            if path is not None:
                # Of a damaged one the material alone colours the surface.
                with contextlib.suppress(ValueError), open_picture(path) as image:
                    self._images[name] = image.convert("RGBA")
        return self._images[name]


def _numbers(text, count):
    numbers = np.array(text.split(), dtype=np.float64)
    if len(numbers) != count:
        raise Damage(f"{text!r} is not {count} numbers")
    return numbers


def split_polygon(corners: np.ndarray) -> list[tuple[int, int, int]]:
    """Triangles of a polygon [K, 3] in space, as triples of indices.

    A convex one is split into a fan. One with dents is cut ear by ear, because a fan
    would reach outside of it.
    """
    after = np.roll(corners, -1, axis=0)
    products = (corners - after).T @ (corners + after)
    normal = products[[1, 2, 0], [2, 0, 1]]  # Newell
    axis = int(np.argmax(np.abs(normal)))  # along it the polygon is seen best
    # Counterclockwise in the plane of the other two.
    flat = np.delete(corners, axis, axis=1)
    flat = (flat * (np.sign(normal[axis]) * (-1 if axis == 1 else 1), 1)).tolist()

    def side(a, b, c):
        (ax, ay), (bx, by), (cx, cy) = flat[a], flat[b], flat[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    count = len(flat)
    if all(side(i - 1, i, (i + 1) % count) >= 0 for i in range(count)):
        return [(0, i, i + 1) for i in range(1, count - 1)]
    triangles: list[tuple[int, int, int]] = []
    left = list(range(count))
    while len(left) > 2:
        for place in range(len(left)):
            ear = a, b, c = left[place - 1], left[place], left[(place + 1) % len(left)]
            inside = (
                min(side(a, b, i), side(b, c, i), side(c, a, i)) >= 0
                for i in left
                if i not in ear
            )
            if side(*ear) > 0 and not any(inside):
                break
        else:  # it crosses itself, so any cut will do
            place, ear = 0, (left[-1], left[0], left[1])
        triangles.append(ear)
        del left[place]
    return triangles
