"""How much memory a projection takes, known before it runs."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from dpc_jax.render.projection import project

# What a compiled program is made for; all other arguments are its inputs.
_STATIC = ("grid", "signals", "method", "ray_rule")


class MemoryEstimate(NamedTuple):
    """Bytes that one call holds at most, by what they are for.

    Attributes:
      arguments: the inputs (with a gradient also the images' cotangents).
      outputs: the images, and the gradients where asked for.
      temporary: everything between, as the compiler has laid it out.
      total: the three together, less what outputs share with inputs.
    """

    arguments: int
    outputs: int
    temporary: int
    total: int


def estimate_memory(
    points, rotation, *, gradient: bool = False, **arguments
) -> MemoryEstimate:
    """Memory of one call of `project`: compiled for this device, but not run.

    Several samples in `jax.lax.map` need `temporary` once, in `jax.vmap` once each.
    The program's own code and the compiler's work are not counted.

    Args:
      points: [N, 3], and rotation: [4] or [3, 3], as for `project`. An array may be
        given as `jax.ShapeDtypeStruct(shape, dtype)`, so that nothing is allocated.
      gradient: with the backward pass, to points, rotation and every other argument
        that is an array of floats or stands for one. Plain numbers, and the camera's,
        are inputs without a gradient.
      **arguments: of `project`.

    Returns:
      A `MemoryEstimate`, in bytes.

    Raises:
      ValueError: as `project`.
      TypeError: for an argument that `project` does not have.
      RuntimeError: where the device's compiler does not tell.
    """
    static = {name: arguments.pop(name) for name in _STATIC if name in arguments}
    inputs = {"points": points, "rotation": rotation, **arguments}
    inputs = {
        name: jnp.asarray(value) if isinstance(value, list | tuple) else value
        for name, value in inputs.items()
    }

    def render(inputs):
        return project(**inputs, **static)

    if gradient:
        moving = {name for name, value in inputs.items() if _is_float_array(value)}
        fixed = {name: inputs[name] for name in inputs if name not in moving}
        moving = {name: inputs[name] for name in moving}

        def render_both_ways(moving, fixed, cotangents):
            images, pull_back = jax.vjp(lambda m: render(m | fixed), moving)
            return images, pull_back(cotangents)

        cotangents = jax.eval_shape(render, inputs)
        lowered = jax.jit(render_both_ways).lower(moving, fixed, cotangents)
    else:
        lowered = jax.jit(render).lower(inputs)
    analysis = lowered.compile().memory_analysis()
    if analysis is None:
        raise RuntimeError(
            "Expected the compiler to tell the memory of a program, but that of "
            f"{jax.default_backend()!r} does not; measure a run instead."
        )
    sizes = (
        analysis.argument_size_in_bytes,
        analysis.output_size_in_bytes,
        analysis.temp_size_in_bytes,
    )
    return MemoryEstimate(*sizes, sum(sizes) - analysis.alias_size_in_bytes)


def _is_float_array(value) -> bool:
    return hasattr(value, "shape") and jnp.issubdtype(value.dtype, jnp.floating)
