"""`project_volume`: poses, lenses and occupancies that are extreme."""

import functools

import numpy as np

from dpc_jax.measure.stability.cases import image_oracles
from dpc_jax.measure.stability.cases.case import IN_WIDE, Case, make_cases
from dpc_jax.render import Camera, VoxelGrid, project_volume

SUBJECT = "volumes of cells"
SHAPE = CELLS = (2, 2, 4)  # of the grid, of the volume
# The translation along x that moves the volume's rim, half a cell beyond its border, to
# the outermost samples on the right, of which the farthest is the last to be left.
LAST = {"perspective": 0.25 * 2.375 / 1.875 + 0.75, "orthographic": 1.0}
TURN = (0.8, 0.1, -0.3, 0.2)
STILL = (1, 0, 0, 0)


def _fill(shape):
    """Occupancies from 0.1 to 0.9 and two channels of colour, without a pattern."""
    numbers = np.arange(np.prod(shape))
    volume = 0.1 + 0.8 * ((numbers * 13) % 31) / 31
    colors = np.stack([(numbers * 7) % 11, (numbers * 5) % 17], axis=-1) / 16
    return volume.reshape(shape), colors.reshape(*shape, 2)


VOLUME, COLORS = _fill(CELLS)
PLAIN = {
    "volume": VOLUME,
    "colors": COLORS,
    "rotation": TURN,
    "translation": (0.03, -0.05, 0.02),
    "focal": 1.875,
    "distance": 2.0,
}
ONE, CHECKERS = np.eye(16)[6].reshape(CELLS), np.indices(CELLS).sum(0) % 2
AWAY = {"limit": "a volume outside the view shows the background, without gradient"}
BEHIND = {"limit": "cells behind, or within 1e-6 extents before the camera, are empty"}
FULL = {"limit": "an occupancy above 1 is clipped: its slope is zero"}
KINK = {"limit": "on a cell's centre the slope is that towards the higher index"}
EMPTY = {"limit": "an occupancy of 0 has the slope of the inner side"}
ROUNDINGS = "an index of a few cells carries 30 roundings, tents multiply them by their"
ROUNDINGS += " slope, rays by their length"
GRAZING = {
    "value_tolerance": 8 * 1024,
    "gradient_tolerance": 8 * 1024,
    "because": "the samples are thousandths of the indices whose rounding they have",
}
# What differs from `PLAIN`, and the fields of `Case`.
SCENES = (
    ("plain", {}, {}),
    ("occupancies 0", {"volume": 0 * VOLUME}, EMPTY),
    ("occupancies 1", {"volume": 0 * VOLUME + 1}, {}),
    ("one full cell, the others empty", {"volume": ONE}, EMPTY),
    ("full and empty cells in turn", {"volume": CHECKERS}, EMPTY),
    ("occupancies 1e-30", {"volume": VOLUME * 1e-30}, IN_WIDE),
    ("occupancies 1e6", {"volume": VOLUME * 1e6}, IN_WIDE | FULL),
    ("occupancies 1e30", {"volume": VOLUME * 1e30}, IN_WIDE | FULL),
    ("occupancies below 0", {"volume": -VOLUME}, {}),
    ("occupancies from -3 to 5", {"volume": VOLUME * 10 - 4}, FULL),
    ("colours 1e30", {"colors": COLORS * 1e30}, IN_WIDE),
    ("colours 1e-30", {"colors": COLORS * 1e-30}, IN_WIDE),
    ("colours below 0", {"colors": -COLORS}, {}),
    ("quaternion of length 1e-30", {"rotation": np.multiply(TURN, 1e-30)}, IN_WIDE),
    ("quaternion of length 1e30", {"rotation": np.multiply(TURN, 1e30)}, IN_WIDE),
    ("quaternion 0", {"rotation": np.zeros(4)}, {}),
    ("half turn", {"rotation": (0, 1, 0, 0)}, {}),
    ("turned by 1e-6", {"rotation": (1, 1e-6, 0, 0)}, IN_WIDE),
    (
        "samples on the cells' centres",
        {"rotation": STILL, "translation": np.zeros(3)},
        KINK,
    ),
    ("moved by 3", {"translation": (3, 0, 0)}, AWAY),
    ("moved behind the camera", {"translation": (0, 0, -9)}, AWAY),
    ("moved by 1e30", {"translation": (1e30, -1e30, 1e30)}, IN_WIDE | AWAY),
    ("moved by 3e38", {"translation": (3e38, 3e38, -3e38)}, IN_WIDE | AWAY),
    ("the camera inside", {"distance": 0.1}, BEHIND),
    # By `TURN` a sample would lie on a cell's centre, but for rounding.
    (
        "the camera in the middle",
        {"distance": 0.0, "rotation": (0.8, 0.13, -0.3, 0.21)},
        BEHIND,
    ),
    ("the volume behind the camera", {"distance": -2.0}, BEHIND | AWAY),
    ("distance 1e6, focal length 1e6", {"distance": 1e6, "focal": 1e6}, IN_WIDE),
    ("distance 1e30", {"distance": 1e30}, IN_WIDE | AWAY),
    ("focal length 1e-6", {"focal": 1e-6}, IN_WIDE | AWAY),
    ("focal length 1e6", {"focal": 1e6}, IN_WIDE),
    ("focal length 1e30", {"focal": 1e30}, IN_WIDE),
)

_ORTHOGRAPHIC = ("plain", "samples", "moved", "quaternion 0", "half")


def _graze(projection):
    """Rays on both sides of the rim, a thousandth of a cell from it."""
    for side, step, fields in (("inside", -5e-4, GRAZING), ("outside", 5e-4, AWAY)):
        moved = {"rotation": STILL, "translation": (LAST[projection] + step, 0.1, 0.07)}
        name = f"the outermost ray a thousandth of a cell {side} of the rim"
        yield name, moved, IN_WIDE | fields


def _make_shape(name, shape, fields):
    volume, colors = _fill(shape)
    return name, {"volume": volume, "colors": colors}, fields


SHAPES = (
    _make_shape("one cell", (1, 1, 1), {}),
    _make_shape("a rod of 32 cells", (1, 1, 32), {}),
    _make_shape("a plate one cell thick", (5, 1, 4), {}),
)


def _render(volume, colors, rotation, translation, focal, distance, *, projection):
    """The three images of a volume."""
    image = project_volume(
        volume,
        rotation,
        colors=colors,
        translation=translation,
        camera=Camera(focal, distance, projection),
        grid=VoxelGrid(SHAPE),
        signals=("silhouette", "depth", "color"),
    )
    return image.silhouette, image.depth, image.color


def list_cases() -> list[Case]:
    """The catalogue's cases on volumes of cells."""
    cases = []
    # Orthographic rays differ from the others in where they are, and in that alone.
    few = [row for row in SCENES if row[0].startswith(_ORTHOGRAPHIC)]
    for projection, scenes in (
        ("perspective", (*SCENES, *SHAPES)),
        ("orthographic", few),
    ):
        is_flat = projection == "orthographic"
        cases += make_cases(
            projection,
            functools.partial(_render, projection=projection),
            functools.partial(
                image_oracles.render_cells, shape=SHAPE, orthographic=is_flat
            ),
            (128, 1024),
            [
                (name, *(PLAIN | inputs).values(), fields)
                for name, inputs, fields in (*scenes, *_graze(projection))
            ],
            because=ROUNDINGS,
            half="finite",
            gradient_floor=(1e-30,) * 6,
        )
    return cases
