"""Keypoints of procedural shapes: corners and tips that every shape of a kind has.

A keypoint is the vertex of one part that lies farthest in a direction, in the object
frame (x front, y left, z up): the tip of the front left leg is where "leg" reaches
farthest forward, left and, above all, down.
"""

from typing import NamedTuple

import numpy as np
import trimesh

from dpc_jax.shapes.building_blocks import read_labels
from dpc_jax.shapes.chairs import draw_plan
from dpc_jax.shapes.procedural import make_shape, seed_stream

Direction = tuple[float, float, float]
_SIDES, _ENDS = (("left", 1), ("right", -1)), (("front", 1), ("rear", -1))


def _name_corners(text, label, up):
    """The four keypoints of a part that has a corner front and rear, left and right."""
    return {
        f"{end} {side} {text}": (label, (x, y, up))
        for end, x in _ENDS
        for side, y in _SIDES
    }


def _name_sides(text, label, up):
    """The two keypoints of a part that has a left and a right end."""
    return {f"{side} {text}": (label, (0, y, up)) for side, y in _SIDES}


_CAR: dict[str, tuple[str, Direction]] = {
    **_name_corners("wheel", "wheel", -3),
    **_name_corners("bumper corner", "body", 0),
    **_name_corners("roof corner", "cabin", 3),
}
KEYPOINTS: dict[str, dict[str, tuple[str, Direction]]] = {  # label, direction
    "chair": {
        **_name_corners("seat corner", "seat", 0.1),
        **_name_corners("leg tip", "leg", -3),
        **_name_sides("back corner", "back", 1),
    },
    "car": _CAR,
    "car_simple": _CAR,
    "airplane": {
        "nose": ("body", (1, 0, 0)),
        "rear end": ("body", (-1, 0, 0)),
        "fin tip": ("tail", (-1, 0, 3)),
        **_name_sides("wing tip", "wing", 0),
        **_name_sides("stabiliser tip", "tail", 0),
    },
}
# What a chair stands on at four places. A star or a round foot has no leg tips.
FOUR_FOOTED = ("legs", "sled", "block")
_LEAST_WIDTH = 0.1  # between what is left and what is right


class Keypoint(NamedTuple):
    """A keypoint of one shape: the label of its part, its position [3]."""

    label: str
    position: np.ndarray


def find_keypoints(category: str, seed: int) -> dict[str, Keypoint]:
    """Keypoints by name of the shape that `make_shape` makes of the same arguments.

    What a shape does not have, such as the leg tips of a swivel chair or a wheel in
    each corner of a three-wheeler, is left out.

    Raises:
      ValueError: for an unknown category.
    """
    mesh = make_shape(category, seed)
    found = {
        name: Keypoint(label, _find_extreme(mesh, label, direction))
        for name, (label, direction) in KEYPOINTS[category].items()
    }
    if category == "chair":
        base = draw_plan(seed_stream(category, seed)).base
        if base not in FOUR_FOOTED:
            found = {n: point for n, point in found.items() if point.label != "leg"}
    for left in [name for name in found if "left" in name]:
        right = left.replace("left", "right")
        if found[left].position[1] - found[right].position[1] <= _LEAST_WIDTH:
            del found[left], found[right]
    return found


def _find_extreme(mesh: trimesh.Trimesh, label, direction) -> np.ndarray:
    faces = np.asarray(mesh.faces)[read_labels(mesh) == label]
    vertices = np.asarray(mesh.vertices)[np.unique(faces)]
    return vertices[np.argmax(vertices @ np.asarray(direction, float))]
