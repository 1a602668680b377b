"""What the arguments of a projection must look like; each mistake in a sentence."""

import jax.numpy as jnp

SIGNALS = ("silhouette", "depth", "color")
METHODS = ("auto", "trilinear", "gaussian")
RAY_RULES = ("termination", "maximum")


def check_points(points, rotation, sigma, scale, covariance, translation):
    """Refuse wrong shapes of what places the points.

    Raises:
      ValueError: naming the argument, what was expected and what came.
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(
            f"points must have shape [N, 3], but they have {list(points.shape)}; use "
            "jax.vmap or jax.lax.map over a batch of clouds."
        )
    if not jnp.issubdtype(points.dtype, jnp.floating):
        raise ValueError(
            f"points must be floating point numbers, but they are {points.dtype}; "
            "convert them with points.astype('float32')."
        )
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
    if isinstance(signals, str) or not signals or set(signals) - set(SIGNALS):
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
    ):
        raise ValueError(
            f"colors must have shape [N, C] with N = {points.shape[0]} and C >= 1, but "
            f"they have {list(jnp.shape(colors))}; give one row per point."
        )


def check_background(background_depth, background_color, colors):
    """Refuse background values of a wrong shape.

    Raises:
      ValueError: naming the argument, what was expected and what came.
    """
    if jnp.ndim(background_depth) != 0:
        raise ValueError(
            "background_depth must be one number, but it has shape "
            f"{list(jnp.shape(background_depth))}; pass a scalar."
        )
    channels = () if colors is None else jnp.shape(colors)[1:]
    if jnp.shape(background_color) not in ((), channels):
        raise ValueError(
            f"background_color must be one number or [C] = {list(channels)} like the "
            f"colors, but it has shape {list(jnp.shape(background_color))}; pass one "
            "value per channel."
        )
