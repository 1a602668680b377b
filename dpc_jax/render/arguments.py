"""What the arguments of a projection must look like; else a ValueError says it."""

import jax
from jax.typing import ArrayLike, DTypeLike

from dpc_jax.render import checks
from dpc_jax.render.camera import Camera, VoxelGrid
from dpc_jax.render.fast import splatting

SIGNALS = ("silhouette", "depth", "color", "termination")
METHODS = ("auto", *splatting.ORDERS, "gaussian")
RAY_RULES = ("termination", "maximum")
_POSES = "use jax.vmap over several poses"
_SIZES = "pass a scalar or one value per point"


def convert_scene(
    points: jax.Array,
    rotation: ArrayLike,
    sigma: ArrayLike | None,
    scale: ArrayLike,
    covariance: ArrayLike | None,
    translation: ArrayLike | None,
) -> tuple[jax.Array, jax.Array | None, jax.Array, jax.Array | None, jax.Array | None]:
    """Convert to the dtype of the points [N, 3] what places them; None stays None."""
    if (covariance is None) == (sigma is None):
        came = "none" if sigma is None else "both"
        raise ValueError(
            f"one of sigma and covariance must be given, but {came} came; pass sigma, "
            "() or [N] in voxels, or sigma=None with a covariance [N, 3, 3] in voxels²."
        )
    count = points.shape[0]
    sizes = {"sigma": sigma, "scale": scale, "covariance": covariance}

    def convert(name, value, *shapes, hint):
        array = checks.check_real(name, value, *shapes, hint=hint)
        return array.astype(points.dtype)

    rotation, translation = convert_pose(rotation, translation, points.dtype)
    scale = convert("scale", scale, (), (count,), hint=_SIZES)
    if sigma is not None:
        sigma = convert("sigma", sigma, (), (count,), hint=_SIZES)
    if covariance is not None:
        shape, hint = (count, 3, 3), "pass one matrix per point"
        covariance = convert("covariance", covariance, shape, hint=hint)
    checks.check_values({"points": points} | sizes)
    return rotation, sigma, scale, covariance, translation


def convert_pose(
    rotation: ArrayLike, translation: ArrayLike | None, dtype: DTypeLike
) -> tuple[jax.Array, jax.Array | None]:
    """Convert a rotation [4] or [3, 3] and a translation [3]; None stays None."""
    given = {"rotation": rotation, "translation": translation}
    rotation = checks.check_real("rotation", rotation, (4,), (3, 3), hint=_POSES)
    if translation is not None:
        translation = checks.check_real("translation", translation, (3,), hint=_POSES)
        translation = translation.astype(dtype)
    checks.check_values(given)
    return rotation.astype(dtype), translation


def check_view(camera: Camera, grid: VoxelGrid = VoxelGrid()) -> None:
    """Refuse what is not one camera and one grid."""
    check_types(camera, grid)
    numbers = camera.list_numbers()
    for name, value in numbers.items():
        checks.check_real(name, value, (2,) if name.endswith("point") else ())
    checks.check_values(numbers)


def check_types(camera: Camera, grid: VoxelGrid) -> None:
    """Refuse what is no camera, or no grid."""
    for name, value, kind, example in (
        ("camera", camera, Camera, "dpc_jax.Camera(1.875, 2.0)"),
        ("grid", grid, VoxelGrid, "dpc_jax.VoxelGrid(64)"),
    ):
        if not isinstance(value, kind):
            raise ValueError(
                f"{name} must be a dpc_jax.{kind.__name__}, but it is of type "
                f"{type(value).__name__}; write for example {example}."
            )


def choose_method(method: str, sigma: jax.Array | None) -> str:
    """Resolve "auto", and refuse a method that cannot draw these sizes."""
    checks.check_choice("method", method, METHODS, "'auto' chooses from the arguments")
    if method == "auto":
        is_shared = sigma is not None and sigma.ndim == 0
        return "trilinear" if is_shared else "gaussian"
    if method == "gaussian":
        return method
    if sigma is None or sigma.ndim:
        raise ValueError(
            f"sigma must be one number with the method {method!r}, which smooths all "
            "points alike, but a size per point came; pass method='gaussian'."
        )
    order = splatting.ORDERS[method]
    least = splatting.find_least(order)
    if order > 1 and checks.is_known(sigma) and float(sigma) < least:
        raise ValueError(
            f"sigma must be at least {least:.3f} voxels with the method {method!r}, "
            f"whose splines are as wide, but it is {float(sigma):g}; pass "
            "method='trilinear' or a finer grid."
        )
    return method


def check_signals(signals: tuple[str, ...], ray_rule: str, *, has_colors: bool) -> None:
    """Refuse unknown signals, and colour without colours."""
    is_list = isinstance(signals, tuple | list | set | frozenset)
    if not is_list or not signals or any(s not in SIGNALS for s in signals):
        raise ValueError(
            f"signals must be a non-empty tuple with any of {SIGNALS}, but it is "
            f"{signals!r}; write for example signals=('silhouette',)."
        )
    checks.check_choice("ray_rule", ray_rule, RAY_RULES, "the paper's is 'termination'")
    if "color" in signals and not has_colors:
        raise ValueError(
            "the signal 'color' must have colors of all points or cells, but colors is "
            "None; pass them or leave 'color' out of signals."
        )


def convert_colors(
    colors: ArrayLike | None,
    shape: tuple[int, ...],
    background: tuple[ArrayLike, ArrayLike],
) -> jax.Array | None:
    """Convert the colours of points (N,) or of cells (X, Y, Z) to an array [*shape, C].

    None stays None. Also refuse a depth and a colour of the background that have a
    wrong shape.
    """
    shapes: list[tuple] = [()]
    if colors is not None:
        hint = "give one colour per point, or per cell of a volume"
        colors = checks.check_real("colors", colors, (*shape, "C"), hint=hint)
        shapes.append(colors.shape[-1:])
    background_depth, background_color = background
    checks.check_real("background_depth", background_depth, ())
    hint = "pass one number, or one per channel of the colors"
    checks.check_real("background_color", background_color, *shapes, hint=hint)
    return colors
