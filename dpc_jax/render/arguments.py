"""What the arguments of a projection must look like; each mistake in a sentence."""

import chex
import jax.numpy as jnp

from dpc_jax.render import checks
from dpc_jax.render.camera import Camera, VoxelGrid

SIGNALS = ("silhouette", "depth", "color")
METHODS = ("auto", "trilinear", "gaussian")
RAY_RULES = ("termination", "maximum")


def convert_points(points) -> chex.Array:
    """Points as an array [N, 3].

    Raises:
      ValueError: for anything else.
    """
    over = "use jax.vmap or jax.lax.map over a batch of clouds"
    return checks.check_array("points", points, (None, 3), hint=over)


def check_points(points, rotation, sigma, scale, covariance, translation):
    """Refuse wrong shapes of what places the points.

    Raises:
      ValueError: naming the argument, what was expected and what came.
    """
    if rotation.shape not in ((4,), (3, 3)):
        raise ValueError(
            "rotation must be a quaternion [4] or a matrix [3, 3], but it has shape "
            f"{list(rotation.shape)}; use jax.vmap over several poses."
        )
    count = points.shape[0]
    if covariance is None and sigma is None:
        raise ValueError(
            "a point needs a size, but both sigma and covariance are None; pass sigma "
            "in voxels, () or [N], or covariance [N, 3, 3] in voxels²."
        )
    if covariance is not None and sigma is not None:
        raise ValueError(
            "a point has one size, but both sigma and covariance came; pass "
            "sigma=None with a covariance."
        )
    if covariance is not None and jnp.shape(covariance) != (count, 3, 3):
        raise ValueError(
            f"covariance must have shape [N, 3, 3] with N = {count}, but it has "
            f"{list(jnp.shape(covariance))}; give one matrix per point."
        )
    for name, value in (
        *(("rotation", rotation), ("sigma", sigma), ("scale", scale)),
        *(("covariance", covariance), ("translation", translation)),
    ):
        if value is not None and jnp.iscomplexobj(value):
            raise ValueError(
                f"{name} must be real, but it is {value.dtype}; pass its real part."
            )
    for name, value in (("sigma", sigma), ("scale", scale)):
        if value is not None and jnp.shape(value) not in ((), (count,)):
            raise ValueError(
                f"{name} must be one number or [N] = [{count}], but it has shape "
                f"{list(jnp.shape(value))}; pass a scalar or one value per point."
            )
    if translation is not None and jnp.shape(translation) != (3,):
        raise ValueError(
            "translation must have shape [3], but it has "
            f"{list(jnp.shape(translation))}; use jax.vmap over several poses."
        )


def check_scene(sigma, scale, camera, grid):
    """Refuse what is wrong before any of it is an array.

    Raises:
      ValueError: naming the argument, what was expected and what came.
    """
    checks.check_at_least_zero("sigma", sigma)
    if scale is None:
        raise ValueError(
            "scale must be one number or [N], the mass of a point in voxels, but it is "
            "None; leave it out for 1.0."
        )
    if not isinstance(camera, Camera):
        raise ValueError(
            f"camera must be a dpc_jax.Camera, but it is of type "
            f"{type(camera).__name__}; write for example dpc_jax.Camera(1.875, 2.0)."
        )
    checks.check_number("camera.focal_length", camera.focal_length)
    checks.check_number("camera.distance", camera.distance)
    if not isinstance(grid, VoxelGrid):
        raise ValueError(
            f"grid must be a dpc_jax.VoxelGrid, but it is of type "
            f"{type(grid).__name__}; write for example dpc_jax.VoxelGrid(64)."
        )


def choose_method(method, sigma, covariance) -> str:
    """The method that "auto" stands for; refuses one that cannot do what is asked.

    Raises:
      ValueError: for an unknown method, or "trilinear" with points of several sizes.
    """
    if method not in METHODS:
        raise ValueError(
            f"method must be one of {METHODS}, but it is {method!r}; 'auto' chooses "
            "from the arguments."
        )
    is_shared = covariance is None and jnp.ndim(sigma) == 0
    if method == "auto":
        return "trilinear" if is_shared else "gaussian"
    if method == "trilinear" and not is_shared:
        raise ValueError(
            "the method 'trilinear' smooths all points with one sigma, but a size per "
            "point came; pass method='gaussian' or 'auto'."
        )
    return method


def check_signals(signals, ray_rule, points, colors):
    """Refuse unknown signals, and colour without colours.

    Raises:
      ValueError: naming the argument, what was expected and what came.
    """
    is_list = isinstance(signals, tuple | list | set | frozenset)
    if not is_list or not signals or any(s not in SIGNALS for s in signals):
        raise ValueError(
            f"signals must be a non-empty tuple with any of {SIGNALS}, but it is "
            f"{signals!r}; write for example signals=('silhouette',)."
        )
    if ray_rule not in RAY_RULES:
        raise ValueError(
            f"ray_rule must be one of {RAY_RULES}, but it is {ray_rule!r}; the paper's "
            "is 'termination'."
        )
    if "color" in signals and colors is None:
        raise ValueError(
            "the signal 'color' needs colors of shape [N, C], but colors is None; pass "
            "them or leave 'color' out of signals."
        )
    if colors is not None and (
        jnp.ndim(colors) != 2
        or jnp.shape(colors)[0] != points.shape[0]
        or jnp.shape(colors)[1] == 0
        or jnp.iscomplexobj(colors)
    ):
        raise ValueError(
            f"colors must be real, of shape [N, C] with N = {points.shape[0]} and C >= "
            f"1, but they are {colors.dtype} of shape {list(jnp.shape(colors))}; give "
            "one row per point."
        )


def check_background(background_depth, background_color, colors):
    """Refuse background values of a wrong shape.

    Raises:
      ValueError: naming the argument, what was expected and what came.
    """
    checks.check_number("background_depth", background_depth)
    channels = () if colors is None else jnp.shape(colors)[1:]
    background_color = checks.convert("background_color", background_color)
    if background_color.shape not in ((), channels):
        raise ValueError(
            f"background_color must be one number or [C] = {list(channels)} like the "
            f"colors, but it has shape {list(background_color.shape)}; pass one "
            "value per channel."
        )
