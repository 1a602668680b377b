"""Many renders: a batch of examples on every core or device, equal to one at a time."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import chex
import jax
import jax.numpy as jnp
from jax.sharding import PartitionSpec

from dpc_jax.render import arguments, checks
from dpc_jax.render.blocks import capacity
from dpc_jax.render.camera import Camera, VoxelGrid
from dpc_jax.render.devices import choose_mesh, find_platform, place
from dpc_jax.render.fast import splatting
from dpc_jax.render.projection import STATIC, Projection, project

_SIZES = (
    "give one number for all, [B] one for each example, [B, N] one for each point, or "
    "[1, N] for points that all examples share"
)
_SHARED = "leave out the first axis of what all examples share"


def project_batch(
    points: jax.Array,
    rotations: jax.Array,
    *,
    sigma: chex.Numeric | None = None,
    scale: chex.Numeric = 1.0,
    covariance: jax.Array | None = None,
    colors: jax.Array | None = None,
    translations: jax.Array | None = None,
    camera: Camera = Camera(),
    grid: VoxelGrid = VoxelGrid(64),
    signals: tuple[str, ...] = ("silhouette",),
    method: str = "auto",
    ray_rule: str = "termination",
    background_depth: chex.Numeric = 10.0,
    background_color: chex.Numeric = 1.0,
    max_blocks: int | None = None,
    renders_at_once: int | None = None,
    devices: Sequence[Any] | None = None,
) -> Projection:
    """Render B examples on every core or device; equal to `project` of each.

    Differentiable, and usable inside `jax.jit`. Every device takes an equal share of
    the examples, and B need not divide. CPU cores are devices after
    `dpc_jax.use_all_cores()`; without it they are one.

    The rank of an array says whether all examples share it. B is the rotations'.

    Args:
      points: [B, N, 3], or [N, 3] shared.
      rotations: [B, 4] quaternions wxyz or [B, 3, 3] matrices; never shared.
      sigma, scale: () shared, [B] one for each example, [B, N] one for each point, or
        [1, N] one for each point and shared. So [N] is never for points.
      covariance: [B, N, 3, 3], or [N, 3, 3] shared.
      colors: [B, N, C], or [N, C] shared.
      translations: [B, 3], or [3] shared.
      camera: its focal length and distance are () shared or [B].
      grid, signals, method, ray_rule, background_depth, background_color: shared, as
        in `project`.
      max_blocks: as in `project`, for each example; None counts those of the example
        that touches most.
      renders_at_once: how many renders a device makes side by side; static. None for
        what suits it: one keeps a CPU's cache, all fill a GPU.
      devices: JAX's, to render on; static. None for all of this process, or the one
        that `jax.default_device` names. Inside `jax.set_mesh` the mesh's devices are
        used; inside `jax.shard_map` or `jax.pmap` a device renders its own share.

    Returns:
      Images with a leading axis B, divided among the devices; [0, rows, cols] where B
      is 0.

    Raises:
      ValueError: as `project`, and for shapes that do not fit B.

    Example:
      >>> images = dpc_jax.project_batch(jnp.zeros((1, 3)), jnp.eye(4), sigma=1.5)
      >>> images.silhouette.shape
      (4, 64, 64)
    """
    arguments.check_signals(signals, ray_rule, has_colors=colors is not None)
    arguments.check_types(camera, grid)
    if renders_at_once is not None:
        checks.check_count("renders_at_once", renders_at_once, least=1)
    hint = "give one rotation for each example; dpc_jax.project takes a single one"
    rotations = checks.check_real(
        "rotations", rotations, ("B", 4), ("B", 3, 3), hint=hint
    )
    batch_size = rotations.shape[0]
    values = {
        "points": points,
        "sigma": sigma,
        "scale": scale,
        "covariance": covariance,
        "colors": colors,
        "translations": translations,
        **camera.list_numbers(),
    }
    shared, own = sort_inputs(values, batch_size=batch_size)
    checks.check_values(values | {"rotations": rotations})
    own["rotation"] = rotations
    is_whole = ray_rule == "maximum" or "termination" in signals
    if max_blocks is None and not is_whole:
        max_blocks = find_room(shared, own, camera.projection, grid, method)
    shared["background_depth"] = background_depth
    shared["background_color"] = background_color
    mesh = choose_mesh(devices, batch_size=batch_size)
    mesh = mesh if batch_size else None
    if mesh is not None:
        shared = place(shared, mesh, PartitionSpec())
        own = _pad_examples(own, mesh=mesh)
        own = place(own, mesh, PartitionSpec(mesh.axis_names))
    return _render_batch(
        shared,
        own,
        batch_size=batch_size,
        mesh=mesh,
        renders_at_once=renders_at_once,
        projection=camera.projection,
        grid=grid,
        signals=tuple(signals),
        method=method,
        ray_rule=ray_rule,
        max_blocks=max_blocks,
    )


def map_renders(function: Callable, inputs: Any, *, renders_at_once: int | None) -> Any:
    """`vmap` over the leading axis, `renders_at_once` entries at a time.

    One volume at a time stays in a CPU's cache; a GPU wants all at once. None (or 0, of
    a config) takes what suits the device: the one place where that is decided.
    """
    count = len(jax.tree.leaves(inputs)[0])
    if not renders_at_once:
        renders_at_once = 1 if find_platform() == "cpu" else count
    if renders_at_once >= count:
        return jax.vmap(function)(inputs)
    if renders_at_once == 1:
        return jax.lax.map(function, inputs)
    return jax.lax.map(function, inputs, batch_size=renders_at_once)


def sort_inputs(values, *, batch_size):
    """(what all examples share, what each has of its own), by name; without None."""
    b = batch_size
    points = checks.check_array(
        "points", values["points"], ("N", 3), (b, "N", 3), hint=_SHARED
    )
    n = points.shape[-2]
    sizes = (), (b,), (b, n), (1, n)
    shapes = {  # that of what is shared, then the others
        "points": ((n, 3), (b, n, 3)),
        "sigma": sizes,
        "scale": sizes,
        "covariance": ((n, 3, 3), (b, n, 3, 3)),
        "colors": ((n, "C"), (b, n, "C")),
        "translations": ((3,), (b, 3)),
        "camera.focal_length": ((), (b,)),
        "camera.distance": ((), (b,)),
        "camera.principal_point": ((2,), (b, 2)),
        "camera.aspect": ((), (b,)),
    }
    shared, own = {}, {}
    for name, value in values.items():
        if value is None:
            continue
        allowed = shapes[name]
        hint = _SIZES if allowed is sizes else _SHARED
        array = checks.check_real(name, value, *allowed, hint=hint)
        if name == "translations":
            name = "translation"  # of `project`
        if array.ndim == len(allowed[0]):
            shared[name] = value  # a Python number has the dtype of the points
        elif allowed is sizes and array.shape[0] == 1 != b:
            shared[name] = array[0]
        else:
            own[name] = array
    return shared, own


def _pad_examples(own, *, mesh):
    """Repeat the last example until all devices have as many."""
    extra = -len(own["rotation"]) % mesh.size
    if not extra:
        return own
    own = place(own, mesh, PartitionSpec())
    return jax.tree.map(
        lambda a: jnp.pad(a, [(0, extra)] + [(0, 0)] * (a.ndim - 1), mode="edge"), own
    )


def _take_camera(values, projection):
    """(the other values by name, the camera)."""
    rest, lens = {}, {"projection": projection}
    for name, value in values.items():
        into = lens if name.startswith("camera.") else rest
        into[name.removeprefix("camera.")] = value
    return rest, Camera(**lens)


def find_room(shared, own, projection, grid, method, *, spare=1.0):
    """`max_blocks` of all examples, times `spare`; None for the whole volume.

    Args:
      shared, own: of `sort_inputs`, own with "rotation", too.
    """
    sigma = own.get("sigma", shared.get("sigma"))
    # One for all points of an example.
    has_one_size = sigma is not None and jnp.ndim(sigma) == ("sigma" in own)
    if not has_one_size or method not in ("auto", *splatting.ORDERS):
        return None
    how = {"projection": projection, "grid": grid, "method": method}
    return capacity.count_room(
        lambda: spare * _count_blocks(shared, own, **how), grid.shape, (shared, own)
    )


@functools.partial(jax.jit, static_argnames=("projection", "grid", "method"))
def _count_blocks(shared, own, *, projection, grid, method):
    """The most blocks that an example touches, ()."""
    names = ("points", "rotation", "sigma", "translation")

    def count_one(one):
        values, camera = _take_camera(shared | one, projection)
        known = {name: values[name] for name in names if name in values}
        return capacity.count_blocks(**known, camera=camera, grid=grid, method=method)

    return jnp.max(jax.lax.map(count_one, own), initial=0)


@functools.partial(
    jax.jit,
    static_argnames=("batch_size", "mesh", "renders_at_once", "projection", *STATIC),
)
def _render_batch(
    shared, own, *, batch_size, mesh, renders_at_once, projection, **static
):
    def render_share(shared, own):
        def render_one(one):
            values, camera = _take_camera(shared | one, projection)
            return project(**values, camera=camera, **static)

        return map_renders(render_one, own, renders_at_once=renders_at_once)

    if mesh is None:
        return render_share(shared, own)
    share = PartitionSpec(mesh.axis_names)
    images = jax.shard_map(
        render_share,
        mesh=mesh,
        in_specs=(PartitionSpec(), share),
        out_specs=share,
        # No device needs another's result, and the custom derivatives of a render do
        # not say which of their arrays differ between devices.
        check_vma=False,
    )(shared, own)
    if batch_size % mesh.size == 0:
        return images
    images = place(images, mesh, PartitionSpec())
    return jax.tree.map(lambda image: image[:batch_size], images)
