"""Which devices a batch is rendered on."""

import os
import re
from collections.abc import Sequence
from typing import Any

import jax
from jax.core import Tracer
from jax.sharding import PartitionSpec

from dpc_jax.render import checks


def use_all_cores(count: int | None = None) -> int:
    """Make a JAX device of every CPU core; call it before JAX computes anything.

    JAX takes all cores of a machine for one device, and a render hardly uses the second
    core. With a device for each, `project_batch` gives every core its own examples. The
    environment variable JAX_NUM_CPU_DEVICES=2 does the same. GPUs are not affected.

    Args:
      count: how many devices; None for the cores that this process may use, or what
        JAX's own settings say. In a container with a smaller share of the
        processor than it shows cores, give the number.

    Returns:
      How many CPU devices there are.

    Raises:
      ValueError: for a count that is not a positive integer.
      RuntimeError: if JAX has started already, with fewer devices.

    Example:
      >>> dpc_jax.use_all_cores()  # doctest: +SKIP
      8
    """
    if count is None:
        count = read_settings() or count_cores()
    checks.check_count("count", count, least=1)
    try:
        jax.config.update("jax_num_cpu_devices", int(count))
    except RuntimeError as error:
        found = len(jax.local_devices(backend="cpu"))
        if found < count:
            raise RuntimeError(
                f"Expected to make {count} devices of the CPU's cores, but JAX has "
                f"started with {found}; call dpc_jax.use_all_cores() before the first "
                "JAX array is made, or set the environment variable "
                f"JAX_NUM_CPU_DEVICES={count} before Python starts."
            ) from error
        return found
    return int(count)


def read_settings() -> int:
    """How many CPU devices JAX's own settings ask for; 0 where they do not."""
    flag = r"--xla_force_host_platform_device_count=(\d+)"
    given = re.findall(flag, os.environ.get("XLA_FLAGS", ""))
    count = jax.config.values["jax_num_cpu_devices"]
    return count if count > 0 else int(given[-1]) if given else 0


def count_cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0))


def choose_mesh(
    devices: Sequence[Any] | None, *, batch_size: int
) -> jax.sharding.Mesh | jax.sharding.AbstractMesh | None:
    """The devices that share a batch; None where it stays on the one at hand.

    No more than are needed: five examples on four devices take the time of two, which
    three devices reach as well. Inside a user's `jax.set_mesh` it is that mesh; inside
    `jax.shard_map` and `jax.pmap`, where each device has its own batch, it is None.

    Raises:
      ValueError: for devices named inside a mesh, or none at all.
    """
    current = jax.sharding.get_abstract_mesh()
    if not current.empty:
        if devices is not None:
            raise ValueError(
                "devices must be None inside jax.set_mesh, jax.shard_map or jax.pmap, "
                f"but {len(devices)} came; leave them out: the mesh has its own."
            )
        return None if current.manual_axes else current
    chosen = _list_default_devices() if devices is None else devices
    if len(chosen) == 0:
        raise ValueError(
            "devices must be at least one, but none came; leave them out to use all."
        )
    rounds = max(1, -(-batch_size // len(chosen)))
    needed = max(1, -(-batch_size // rounds))
    if devices is None and needed == 1:
        return None  # wherever the inputs are
    return jax.make_mesh(
        (needed,),
        ("examples",),
        axis_types=(jax.sharding.AxisType.Auto,),
        devices=chosen[:needed],
    )


def place(
    tree: Any, mesh: jax.sharding.Mesh | jax.sharding.AbstractMesh, spec: PartitionSpec
) -> Any:
    """Arrays on the devices of a mesh, wherever they were; traced ones only if need be.

    A mesh with explicit axes (of `jax.set_mesh`) wants to be told of every change;
    for one with automatic axes the compiler moves what has to be moved.
    """
    if jax.sharding.AxisType.Explicit in mesh.axis_types:
        return jax.sharding.reshard(tree, spec)
    is_traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))
    if is_traced or not isinstance(mesh, jax.sharding.Mesh):
        return tree
    return jax.device_put(tree, jax.sharding.NamedSharding(mesh, spec))


def find_platform() -> str:
    """Where computations run unless told otherwise: "cpu", "gpu" or another."""
    return _list_default_devices()[0].platform


def _list_default_devices():
    """All local devices, or the one that the user has made the default."""
    chosen = jax.config.values["jax_default_device"]
    if chosen is None:
        return jax.local_devices()
    if isinstance(chosen, str):
        return jax.local_devices(backend=chosen)
    return [chosen]
