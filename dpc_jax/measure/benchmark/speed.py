"""The engine beside its peers, and how large a render can get."""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec

from dpc_jax.measure.benchmark.plan import SEED, Case
from dpc_jax.measure.benchmark.pytorch import has_torch, make_torch_call
from dpc_jax.measure.scenes import make_scenes
from dpc_jax.measure.timing import measure_medians
from dpc_jax.render import VoxelGrid, count_blocks, project, project_batch
from dpc_jax.render.devices import choose_mesh, place

# The whole volume of a larger grid takes more memory than many machines have.
_WHOLE_UP_TO = 512
_TORCH_UP_TO = 256  # which keeps every step's volume


def _draw_work(case: Case) -> list[np.ndarray]:
    """Points [B, N, 3], quaternions [B, 4], masses [B] and targets [B, D, D]."""
    rng = np.random.default_rng(SEED)
    points = rng.uniform(-0.4, 0.4, (case.batch, case.points, 3))
    quaternions = rng.normal(size=(case.batch, 4))
    # A mean occupancy of 0.03, so that some of the middle is clipped.
    masses = np.full(case.batch, 0.03 * case.side**3 / case.points)
    targets = rng.uniform(size=(case.batch, case.side, case.side))
    return [a.astype("f4") for a in (points, quaternions, masses, targets)]


def _make_call(work, sigma) -> Callable[[], Any]:
    """A call that gives the gradients of points, quaternions and masses.

    Arrays lie where the steps of a descent would leave them: shared out among devices.
    """
    arrays = tuple(map(jnp.asarray, work))
    mesh = choose_mesh(None, batch_size=len(work[0]))
    if mesh is not None and len(work[0]) % mesh.size == 0:
        arrays = place(arrays, mesh, PartitionSpec(mesh.axis_names))
    *inputs, targets = arrays
    grid = VoxelGrid(targets.shape[-1])

    @jax.jit
    @jax.grad
    def gradient(inputs, targets, sigma):
        points, rotations, masses = inputs
        images = project_batch(points, rotations, sigma=sigma, scale=masses, grid=grid)
        return jnp.sum((images.silhouette - targets) ** 2)

    return lambda: gradient(tuple(inputs), targets, jnp.asarray(sigma, jnp.float32))


def compare_with_peers(case: Case, *, rounds: int) -> dict[str, Any]:
    """Silhouette, forward and backward, by `project_batch` and in PyTorch.

    Returns:
      A record: the case, median seconds of each call, and the relative distances of
      the gradients from ours.
    """
    work = _draw_work(case)
    calls = {"project_batch": _make_call(work, case.sigma)}
    if has_torch():
        calls["PyTorch"] = make_torch_call(tuple(work[:3]), work[3], sigma=case.sigma)
    own, *others = (
        [np.asarray(value, np.float64) for value in call()] for call in calls.values()
    )
    differences = [[*map(measure_distance, other, own)] for other in others]
    return {
        "case": str(case),
        "median_seconds": measure_medians(calls, rounds=rounds),
        "gradient_difference": dict(zip(list(calls)[1:], differences, strict=True)),
    }


def compare_volumes(
    case: Case, signals: tuple[str, ...], *, rounds: int
) -> dict[str, Any]:
    """A car's surface in the whole volume and in touched blocks, forward and backward.

    Beside them the same silhouette in PyTorch, if it is installed.

    Returns:
      A record: the case, which part of the blocks is touched, median seconds, the
      bytes of the arguments and of all in between, and the relative distance between
      the gradients.
    """
    (scene, *_) = make_scenes(num_points=case.points, num_sparse=1, seed=SEED)
    points, pose = (jnp.asarray(a, jnp.float32) for a in (scene.points, scene.pose))
    grid = VoxelGrid(case.side)
    look: dict[str, Any] = {"sigma": case.sigma, "grid": grid, "signals": signals}
    look["scale"] = scene.mass * (case.side / 64) ** 2  # the rays' opacity stays
    if "color" in signals:
        look["colors"] = points + 0.5
    count = int(count_blocks(points, pose, sigma=case.sigma, grid=grid))
    # Room as a batch of other views needs it.
    rooms: dict[str, int | None] = {"blocks": int(1.2 * count)}
    if case.side <= _WHOLE_UP_TO:
        rooms["whole"] = None
    calls, sizes = {}, {}
    for name, room in rooms.items():
        how = look | {"max_blocks": room}
        program = _compile_volume(how, points, pose)
        calls[name] = functools.partial(program, points, pose)
        layout: Any = program.memory_analysis()
        sizes[name] = layout.temp_size_in_bytes + layout.argument_size_in_bytes
    gradients = [np.asarray(call(), np.float64) for call in calls.values()]
    medians = measure_medians(calls, rounds=rounds)
    if has_torch() and signals == ("silhouette",) and case.side <= _TORCH_UP_TO:
        # Not in turns with the others: its threads wait busily for its next call.
        peer = {"PyTorch": _prepare_torch(scene, case, look["scale"])}
        medians |= measure_medians(peer, rounds=rounds)
    return {
        "case": str(case),
        "signals": list(signals),
        "share": count / math.prod(-(-side // 8) for side in grid.shape),
        "median_seconds": medians,
        "bytes": sizes,
        "gradient_difference": measure_distance(*gradients) if gradients[1:] else None,
    }


def _prepare_torch(scene, case, mass):
    arrays = (a[None].astype("f4") for a in (scene.points, scene.pose))
    targets = np.full((1, case.side, case.side), 0.3, "f4")
    inputs = (*arrays, np.full(1, mass, "f4"))
    return make_torch_call(inputs, targets, sigma=case.sigma)


def _compile_volume(look, points, pose):
    def compute_loss(points, pose):
        images = project(points, pose, **look)
        return sum(jnp.sum((image - 0.3) ** 2) for image in jax.tree.leaves(images))

    return jax.jit(jax.grad(compute_loss)).lower(points, pose).compile()


def measure_distance(value: np.ndarray, reference: np.ndarray) -> float:
    """Relative L2 distance."""
    distance = np.linalg.norm(np.asarray(value, np.float64) - reference)
    return float(distance / np.linalg.norm(reference))
