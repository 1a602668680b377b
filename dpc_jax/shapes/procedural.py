"""Procedural shapes of a category: cars, chairs, airplanes without any download.

"car" has everything with wheels, from three-wheelers to trucks and double-deckers;
"car_simple" has the seven usual styles of passenger cars, which look much alike.
"""

import numpy as np
import trimesh

from dpc_jax.shapes.airplanes import make_airplane
from dpc_jax.shapes.cars import make_car, make_simple_car
from dpc_jax.shapes.chairs import make_chair
from dpc_jax.shapes.normalization import normalize

MAKERS = {
    "car": make_car,
    "chair": make_chair,
    "airplane": make_airplane,
    "car_simple": make_simple_car,
}
CATEGORIES = tuple(MAKERS)
_STREAMS = {"car": 0, "chair": 1, "airplane": 2, "car_simple": 0}


def make_shape(category: str, seed: int) -> trimesh.Trimesh:
    """Mesh of a random object of one of `CATEGORIES`; the seed decides all of it.

    It has face colours, z up, front towards +x and left towards +y, and is centred on
    its bounding box, whose diagonal is 1.

    Raises:
      ValueError: for an unknown category.
    """
    rng = seed_stream(category, seed)
    return normalize(MAKERS[category](rng))


def seed_stream(category: str, seed: int) -> np.random.Generator:
    """The random stream that a shape is drawn from; its plan comes first.

    Raises:
      ValueError: for an unknown category.
    """
    if category not in MAKERS:
        raise ValueError(
            f"category must be one of {', '.join(CATEGORIES)}, but it is "
            f"{category!r}; choose one of these or give a folder of meshes."
        )
    return np.random.default_rng([seed, _STREAMS[category]])
