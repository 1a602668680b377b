"""How much memory a projection takes, before it runs."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from dpc_jax.render.projection import STATIC, project


class MemoryEstimate(NamedTuple):
    """The most bytes that one call holds, by purpose.

    Attributes:
      arguments: the inputs; with a gradient, the images' cotangents too.
      outputs: the images, and the gradients where asked for.
      temporary: everything in between, as laid out by the compiler.
      total: the sum of the three, less what outputs share with inputs.
    """

    arguments: int
    outputs: int
    temporary: int
    total: int


def estimate_memory(
    points: ArrayLike | jax.ShapeDtypeStruct,
    rotation: ArrayLike | jax.ShapeDtypeStruct,
    *,
    gradient: bool = False,
    **arguments: Any,
) -> MemoryEstimate:
    """Memory of one call of `project`: compiled for this device, but not run.

    Several samples need `temporary` once in `jax.lax.map`, once each in `jax.vmap`.
    The program's code and the memory of compiling it are not counted.

    Args:
      points: [N, 3], as for `project`. This and every other array may be given as
        `jax.ShapeDtypeStruct(shape, dtype)`, so that nothing is allocated.
      rotation: [4] or [3, 3].
      gradient: include the backward pass, with respect to points, rotation and every
        other array of floats. Plain numbers, and those of the camera, are inputs
        without a gradient.
      **arguments: of `project`.

    Returns:
      `MemoryEstimate`, in bytes.

    Raises:
      ValueError: as `project`.
      TypeError: for an argument that `project` does not have.

    Example:
      >>> cloud = jax.ShapeDtypeStruct((8000, 3), "float32")
      >>> 1e6 < dpc_jax.estimate_memory(cloud, jnp.eye(3), sigma=1.0).total < 1e7
      True
    """
    static = {name: arguments.pop(name) for name in STATIC if name in arguments}
    inputs = {"points": points, "rotation": rotation, **arguments}
    for name, value in inputs.items():
        if isinstance(value, list | tuple):
            inputs[name] = jnp.asarray(value)

    def render(inputs):
        return project(**inputs, **static)

    if gradient:
        moving = {name: v for name, v in inputs.items() if _is_float_array(v)}
        fixed = {name: v for name, v in inputs.items() if name not in moving}

        def render_both_ways(moving, fixed, cotangents):
            images, pull_back = jax.vjp(lambda m: render(m | fixed), moving)
            return images, pull_back(cotangents)

        cotangents = jax.eval_shape(render, inputs)
        lowered = jax.jit(render_both_ways).lower(moving, fixed, cotangents)
    else:
        lowered = jax.jit(render).lower(inputs)
    analysis: Any = lowered.compile().memory_analysis()
    purposes = ("argument", "output", "temp")
    sizes = [getattr(analysis, f"{name}_size_in_bytes") for name in purposes]
    return MemoryEstimate._make([*sizes, sum(sizes) - analysis.alias_size_in_bytes])


def _is_float_array(value):
    return hasattr(value, "shape") and jnp.issubdtype(value.dtype, jnp.floating)
