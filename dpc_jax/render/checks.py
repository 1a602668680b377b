"""Refusing wrong arguments: a ValueError says what was expected and what came."""

import math
import numbers
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike, DTypeLike

_SEVERAL = "use jax.vmap over several"
# Largest difference of RᵀR from the identity that is taken for rounding: bfloat16, and
# products on a GPU that rounds to TF32, have such.
_ROTATION_ROUNDING = 0.02
# Likewise the most negative eigenvalue of a covariance, by its largest entry.
_COVARIANCE_ROUNDING = 1e-3
_MOST_CELLS = 2**31 - 1  # gradients number them in int32
_MOST_MASS = np.finfo(np.float32).max  # of a point; more overflows where points do not


def check_real(
    name: str, value: ArrayLike | None, *shapes: tuple, hint: str = _SEVERAL
) -> jax.Array:
    """Convert a value to an array of real numbers that has one of some shapes.

    In a shape None and a letter stand for any size, and `...` in the first place for
    any number of axes. The hint says what to do about another shape.
    """
    array = _convert(name, value)
    if not any(_fits(array.shape, shape) for shape in shapes):
        wanted = " or ".join(_describe(shape) for shape in shapes)
        raise ValueError(
            f"{name} must have shape {wanted}, but it has {list(array.shape)}; {hint}."
        )
    if jnp.iscomplexobj(array):
        raise ValueError(
            f"{name} must be real, but it is {array.dtype}; pass its real part."
        )
    return array


def check_array(
    name: str, value: ArrayLike | None, *shapes: tuple, hint: str = _SEVERAL
) -> jax.Array:
    """Convert as `check_real`, but refuse integers and truth values too."""
    array = check_real(name, value, *shapes, hint=hint)
    if not jnp.issubdtype(array.dtype, jnp.floating):
        raise ValueError(
            f"{name} must be floating point numbers, but they are {array.dtype}; "
            f"convert them with {name}.astype('float32')."
        )
    return array


def check_choice(name: str, value: str, choices: Sequence[str], hint: str) -> None:
    """Refuse a word that is not among the choices."""
    if value not in choices:
        raise ValueError(
            f"{name} must be one of {choices}, but it is {value!r}; {hint}."
        )


class _Rule(NamedTuple):
    """What the entries of an argument must be; `holds` gives a bool for each."""

    rank: int  # of one entry
    holds: Callable[[np.ndarray], Any]
    expected: str
    hint: str


def check_values(values: Mapping[str, Any]) -> None:
    """Refuse numbers that make no image, among those that are known already.

    Known are plain numbers, and arrays outside of `jax.jit`, `jax.grad` and `jax.vmap`;
    what is traced there passes, and so does None. All are fetched at once.

    Args:
      values: arguments of renders by name, of the right shapes; with leading axes
        for many. Those without a rule pass.
    """
    known = {n: v for n, v in values.items() if n in _RULES and is_known(v)}
    for name, value in jax.device_get(known).items():
        value, rule = np.asarray(value), _RULES[name]
        if name.startswith("rotation") and value.shape[-1] == 4:
            rule = _QUATERNION
        with np.errstate(all="ignore"):
            is_wrong = ~np.asarray(rule.holds(value))
        if is_wrong.any():
            subject = "it is" if value.ndim == rule.rank else "one is"
            raise ValueError(
                f"{name} must be {rule.expected}, but {subject} "
                f"{value[is_wrong][0].tolist()}; {rule.hint}."
            )


def is_known(value: Any) -> bool:
    """Whether all numbers of a tree are known: not traced, and on this machine."""
    leaves = jax.tree.leaves(value)
    return bool(leaves) and not any(
        isinstance(leaf, Tracer)
        or (isinstance(leaf, jax.Array) and not leaf.is_fully_addressable)
        for leaf in leaves
    )


def _are_finite(vectors):
    found = np.isfinite(vectors)
    # All at once is twenty times as quick as row by row, for a million points.
    return np.True_ if found.all() else found.all(axis=-1)


def _are_rotations(matrices):
    matrices = matrices.astype(np.float64)
    squares = np.swapaxes(matrices, -1, -2) @ matrices
    errors = np.abs(squares - np.eye(3)).max(axis=(-1, -2))
    return (errors <= _ROTATION_ROUNDING) & (np.linalg.det(matrices) > 0)


def _are_covariances(matrices):
    """By the leading minors, which are quicker than eigenvalues."""
    matrices = matrices.astype(np.float64)
    matrices = (matrices + np.swapaxes(matrices, -1, -2)) / 2
    size = np.abs(matrices).max(axis=(-1, -2), keepdims=True)
    m = matrices / np.where(size == 0, 1, size) + _COVARIANCE_ROUNDING * np.eye(3)
    minor = m[..., 0, 0] * m[..., 1, 1] - m[..., 0, 1] ** 2
    return (m[..., 0, 0] > 0) & (minor > 0) & (np.linalg.det(m) > 0)


def _are_views(matrices):
    is_finite = np.isfinite(matrices).all(axis=(-1, -2))
    return is_finite & _are_rotations(matrices[..., :3, :3])


def _are_lenses(matrices):
    focal = np.diagonal(matrices, 0, -1, -2)[..., :2]
    form = np.array([[1, 0, 1], [0, 1, 1], [0, 0, 0]], bool)
    others = np.abs(np.where(form, 0, matrices) - np.diag([0, 0, 1]))
    is_right = others.max(axis=(-1, -2)) <= 1e-9 * focal[..., 0]
    return is_right & (focal > 0).all(-1) & np.isfinite(matrices).all(axis=(-1, -2))


def _are_positive(values):
    return (values > 0) & (values < np.inf)


def _are_quaternions(values):
    return _are_finite(values) & (values != 0).any(axis=-1)


def _are_sizes(values):
    return (values >= 0) & (values <= _MOST_MASS)


_IDENTITY = "(1, 0, 0, 0) leaves the points as they are"
_QUATERNION = _Rule(1, _are_quaternions, "finite and not zero", _IDENTITY)
_ROTATION = "a rotation, with RᵀR = 1 and determinant 1"
_MATRIX = _Rule(2, _are_rotations, _ROTATION, "scale or mirror the points instead")
_SIZE = "at least 0 voxels and finite"
_NUMBER = "finite and above 0"
_FULL = "finite without negative eigenvalues"
_LENS = "[[f_x, 0, c_x], [0, f_y, c_y], [0, 0, 1]], finite and f_x, f_y above 0"
_VIEW = "a rotation [3, 3] and a finite translation"
_OTHER_VIEWS = "invert camera-to-world matrices, and turn axes that look along -z"
_RULES = {
    "points": _Rule(1, _are_finite, "finite", "leave out those that are not"),
    "rotation": _MATRIX,
    "rotations": _MATRIX,
    "sigma": _Rule(0, _are_sizes, _SIZE, "0 leaves each point in its cell"),
    "scale": _Rule(0, _are_sizes, _SIZE, "0 leaves a point out"),
    "covariance": _Rule(2, _are_covariances, _FULL, "a product A·Aᵀ has none"),
    "translation": _Rule(1, _are_finite, "finite", "give it in box diagonals"),
    "camera.focal_length": _Rule(0, _are_positive, _NUMBER, "the paper has 1.875"),
    "camera.distance": _Rule(0, np.isfinite, "finite", "the paper's camera has 2.0"),
    "camera.principal_point": _Rule(1, _are_finite, "finite", "(0, 0) is the middle"),
    "camera.aspect": _Rule(0, _are_positive, _NUMBER, "1 has square units"),
    "K": _Rule(2, _are_lenses, _LENS, "undistort images of cameras with a skew first"),
    "world_to_camera": _Rule(2, _are_views, _VIEW, _OTHER_VIEWS),
    "center": _Rule(1, _are_finite, "finite", "take the middle of the object"),
    "radius": _Rule(0, _are_positive, _NUMBER, "take half the width of the cube"),
}


def check_room(name: str, shape: Sequence[int], dtype: DTypeLike) -> None:
    """Refuse a volume that does not fit into memory, before any of it is there."""
    cells = math.prod(side + 2 for side in shape)  # with a rim
    needed, room = cells * jnp.dtype(dtype).itemsize, _find_room()
    if cells > _MOST_CELLS or needed > room:
        raise ValueError(
            f"{name} must have fewer than 2³¹ cells, the rim about them included, and "
            f"fit into this device's memory of {room / 1e9:.3g} GB, but a volume of "
            f"{list(shape)} takes {needed / 1e9:,.4g} GB; make it coarser."
        )


def _find_room():
    """Bytes of the device that renders, or of the machine where it is a CPU."""
    memory = jax.local_devices()[0].memory_stats() or {}
    if "bytes_limit" in memory:
        return memory["bytes_limit"]
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def check_sides(name: str, sides: Any) -> tuple[int, int, int]:
    """Refuse anything but three positive integers."""
    is_triple = isinstance(sides, tuple | list) and len(sides) == 3
    if not (is_triple and all(_is_integer(side) and side > 0 for side in sides)):
        raise ValueError(
            f"{name} must be three positive integers (rows, cols, depth), but it is "
            f"{sides!r}; give for example (64, 64, 64)."
        )
    rows, cols, depth = map(int, sides)
    return rows, cols, depth


def check_count(name: str, value: Any, *, least: int = 0) -> None:
    """Refuse anything but an integer of at least so many."""
    if not (_is_integer(value) and value >= least):
        raise ValueError(
            f"{name} must be an integer of at least {least}, but it is {value!r}; "
            "leave it out for its default."
        )


def _is_integer(value):
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def _convert(name, value):
    try:
        if value is None:
            raise TypeError
        return jnp.asarray(value)
    except (OverflowError, TypeError, ValueError) as error:
        raise ValueError(
            f"{name} must be an array of numbers, but it is of type "
            f"{type(value).__name__}; pass a NumPy or JAX array."
        ) from error


def _fits(found, wanted):
    if wanted[:1] == (...,):
        wanted = wanted[1:]
        found = found[max(0, len(found) - len(wanted)) :]
    pairs = zip(found, wanted, strict=False)
    return len(found) == len(wanted) and all(
        w is None or isinstance(w, str) or w == f for f, w in pairs
    )


def _describe(shape):
    if not shape:
        return "()"
    words = {None: "N", ...: "..."}
    return "[" + ", ".join(words.get(size, str(size)) for size in shape) + "]"
