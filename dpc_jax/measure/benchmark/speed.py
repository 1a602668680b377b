"""The engine beside its peers; gradients are compared."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec

from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.measure.benchmark.plan import SEED, Case
from dpc_jax.measure.benchmark.pytorch import has_torch, make_torch_call
from dpc_jax.measure.timing import measure_medians
from dpc_jax.render import VoxelGrid, project, project_batch
from dpc_jax.render.devices import choose_mesh, place

ALL_DEVICES, ONE_DEVICE = "ours, all devices", "ours, one device"
ONE_SIZE = "trilinear, one sigma"


class Work(NamedTuple):
    """The arrays of a case, numpy float32."""

    points: np.ndarray  # [B, N, 3]
    quaternions: np.ndarray  # [B, 4]
    masses: np.ndarray  # [B] voxels
    targets: np.ndarray  # [B, D, D]


def _draw_work(case: Case) -> Work:
    """Random points, poses and targets of a case."""
    rng = np.random.default_rng(SEED)
    points = rng.uniform(-0.4, 0.4, (case.batch, case.points, 3))
    quaternions = rng.normal(size=(case.batch, 4))
    # A mean occupancy of 0.03, so that some of the middle is clipped.
    masses = np.full(case.batch, 0.03 * case.side**3 / case.points)
    targets = rng.uniform(size=(case.batch, case.side, case.side))
    return Work(*(a.astype("f4") for a in (points, quaternions, masses, targets)))


def render_ours(
    points: jax.Array,
    rotation: jax.Array,
    mass: jax.Array,
    sigma: jax.Array | float,
    *,
    side: int,
    method: str,
) -> jax.Array:
    """Silhouette [side, side] by `project`; sigma () or [N], voxels."""
    grid = VoxelGrid(side)
    image = project(points, rotation, sigma=sigma, scale=mass, grid=grid, method=method)
    assert image.silhouette is not None  # it is the default signal
    return image.silhouette


def _make_call(work: Work, sigma, method: str = "auto") -> Callable[[], Any]:
    """A call that gives the gradients of points, quaternions and masses."""
    *inputs, targets, sigma = (jnp.asarray(a, jnp.float32) for a in (*work, sigma))
    return functools.partial(_compile_gradient(method), inputs, targets, sigma)


@functools.lru_cache
def _compile_gradient(method):
    """Compiled once for cases of the same sizes; takes sample after sample."""

    def compute_loss(inputs, targets, sigma):
        def compare(one):
            (points, rotation, mass), target = one
            look = {"side": len(target), "method": method}
            image = render_ours(points, rotation, mass, sigma, **look)
            return reprojection_loss(image, target)

        return jnp.sum(jax.lax.map(compare, (inputs, targets)))

    return jax.jit(jax.grad(compute_loss))


def _make_batch_call(work: Work, sigma, *, side) -> Callable[[], Any]:
    """As `_make_call`, by `project_batch` on all devices.

    Arrays lie where the steps of a descent would leave them: shared out.
    """
    arrays = tuple(jnp.asarray(a) for a in work)
    mesh = choose_mesh(None, batch_size=len(work.points))
    if mesh is not None and len(work.points) % mesh.size == 0:
        arrays = place(arrays, mesh, PartitionSpec(mesh.axis_names))

    @jax.jit
    @jax.grad
    def gradient(inputs, targets, sigma):
        points, rotations, masses = inputs
        looks = {"sigma": sigma, "scale": masses, "grid": VoxelGrid(side)}
        images = project_batch(points, rotations, **looks).silhouette
        return jnp.sum((images - targets) ** 2)

    return lambda: gradient(arrays[:3], arrays[3], jnp.asarray(sigma, jnp.float32))


def compare_with_peers(case: Case, *, rounds: int) -> dict[str, Any]:
    """Silhouette, forward and backward, on all devices, on one, and in PyTorch.

    Returns:
      A record: the case, seconds of each call with their medians and ratios to ours on
      all devices, and the relative distances of the gradients from ours.
    """
    work = _draw_work(case)
    calls = {
        ALL_DEVICES: _make_batch_call(work, case.sigma, side=case.side),
        ONE_DEVICE: _make_call(work, case.sigma),
    }
    if has_torch():
        calls["PyTorch"] = make_torch_call(work[:3], work.targets, sigma=case.sigma)
    return _compare(str(case), calls, ALL_DEVICES, rounds)


def compare_sizes(case: Case, *, rounds: int) -> dict[str, Any]:
    """A sigma per point, of 0.7 to 2.5 voxels, by levels and exactly; one for all."""
    work = _draw_work(case)
    sizes = np.random.default_rng([SEED, 2]).uniform(0.7, 2.5, case.points)
    calls = {
        name: _make_call(work, sigma, method)
        for name, method, sigma in (
            ("levels", "levels", sizes),
            ("gaussian", "gaussian", sizes),
            (ONE_SIZE, "trilinear", case.sigma),
        )
    }
    name = f"{case.batch} × {case.points}, D={case.side}, a sigma per point"
    record = _compare(name, calls, "levels", rounds)
    # Another image: nothing to compare.
    del record["gradient_difference"][ONE_SIZE]
    return record


def _compare(name, calls, ours, rounds):
    """Medians, ratios to ours, and how far each gradient is from ours."""
    peers = [name for name in calls if name != ours]
    own = [np.asarray(value, np.float64) for value in calls[ours]()]
    differences = {peer: [*map(measure_distance, calls[peer](), own)] for peer in peers}
    medians = measure_medians(calls, rounds=rounds)
    return {
        "case": name,
        "ours": ours,
        "median_seconds": medians,
        "ratio_to_ours": {peer: medians[peer] / medians[ours] for peer in peers},
        "gradient_difference": differences,
    }


def measure_distance(value: np.ndarray, reference: np.ndarray) -> float:
    """Relative L2 distance; 0 if both are zero, infinite if only the reference is."""
    distance = np.linalg.norm(np.asarray(value, np.float64) - reference)
    size = np.linalg.norm(reference)
    if size == 0:
        return 0.0 if distance == 0 else float("inf")
    return float(distance / size)
