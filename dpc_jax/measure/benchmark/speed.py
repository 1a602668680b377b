"""The engine beside its peers, and how its run time grows; gradients are compared."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec

from dpc_jax.learning.choice.hindsight import choose_candidate
from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.measure.benchmark.peers import (
    Sample,
    has_torch,
    make_torch_call,
    render_plain,
)
from dpc_jax.measure.benchmark.plan import SEED, Case, Plan
from dpc_jax.measure.timing import measure_medians
from dpc_jax.render import Camera, VoxelGrid, project, project_batch
from dpc_jax.render.devices import choose_mesh, place

ALL_DEVICES, ONE_DEVICE = "ours, all devices", "ours, one device"
ONE_SIZE = "trilinear, one sigma"


class Work(NamedTuple):
    """The arrays of a case, numpy float32."""

    points: np.ndarray  # [B, N, 3]
    quaternions: np.ndarray  # [B, 4]; [B, K, 4] where the best of K is chosen
    masses: np.ndarray  # [B] voxels
    targets: np.ndarray  # [B, D, D]


def _draw_work(case: Case, num_candidates: int | None = None) -> Work:
    """Random points, poses (or candidates for them) and targets of a case."""
    rng = np.random.default_rng(SEED)
    points = rng.uniform(-0.4, 0.4, (case.batch, case.points, 3))
    quaternions = rng.normal(size=(case.batch, 4))
    # A mean occupancy of 0.03, so that some of the middle is clipped.
    masses = np.full(case.batch, 0.03 * case.side**3 / case.points)
    targets = rng.uniform(size=(case.batch, case.side, case.side))
    if num_candidates:
        rng = np.random.default_rng([SEED, 1])
        quaternions = rng.normal(size=(case.batch, num_candidates, 4))
    return Work(*(a.astype("f4") for a in (points, quaternions, masses, targets)))


def render_ours(
    sample: Sample, sigma: jax.Array | float, *, side: int, method: str = "auto"
) -> jax.Array:
    """Silhouette [side, side] by `project`; sigma () or [N], voxels."""
    points, rotation, mass = sample
    grid = VoxelGrid(side)
    image = project(points, rotation, sigma=sigma, scale=mass, grid=grid, method=method)
    assert image.silhouette is not None  # it is the default signal
    return image.silhouette


def _make_call(loss, work: Work, sigma) -> Callable[[], Any]:
    """A call that gives the gradients of points, quaternions and masses.

    `loss` is that of one sample; samples are taken one after the other.
    """
    gradient = _compile_gradient(loss)
    inputs = tuple(jnp.asarray(a) for a in work[:3])
    rest = jnp.asarray(work.targets), jnp.asarray(sigma, jnp.float32)
    return lambda: gradient(inputs, *rest)


@functools.lru_cache
def _compile_gradient(loss):
    def compute_loss(inputs, targets, sigma):
        samples = inputs, targets
        return jnp.sum(jax.lax.map(lambda one: loss(*one, sigma), samples))

    return jax.jit(jax.grad(compute_loss))


@functools.lru_cache
def _make_loss(render, **static):
    """The loss of one sample, of which `render` gives the silhouette."""

    def compute_loss(sample, target, sigma):
        image = render(sample, sigma, side=target.shape[0], **static)
        return reprojection_loss(image, target)

    return compute_loss


_compute_loss = _make_loss(render_ours)


def _choose_first(sample, target, sigma):
    """The loss of the best of K candidates, found without a gradient."""
    points, candidates, mass = sample
    p, c, m = jax.lax.stop_gradient(sample)
    best = choose_candidate(p, m, c, target, sigma=sigma, camera=Camera())
    return _compute_loss((points, candidates[best], mass), target, sigma)


def _take_minimum(sample, target, sigma):
    """The least of the losses of K candidates, all with a gradient."""
    points, candidates, mass = sample

    def compute_one(candidate):
        return _compute_loss((points, candidate, mass), target, sigma)

    return jnp.min(jax.vmap(compute_one)(candidates))


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


def prepare_render(case: Case, *, method: str = "auto") -> Callable[[], Any]:
    """A call that gives the gradients of our own render on the arrays of a case."""
    return _make_call(
        _make_loss(render_ours, method=method), _draw_work(case), case.sigma
    )


def compare_with_peers(case: Case, *, rounds: int) -> dict[str, Any]:
    """Silhouette, forward and backward, beside the plain ways to write it.

    Returns:
      A record: the case, seconds of each call with their medians and ratios to ours on
      all devices, and the relative distances of the gradients from ours.
    """
    work = _draw_work(case)
    calls = {
        ALL_DEVICES: _make_batch_call(work, case.sigma, side=case.side),
        ONE_DEVICE: _make_call(_make_loss(render_ours), work, case.sigma),
        "plain JAX": _make_call(_make_loss(render_plain), work, case.sigma),
    }
    if has_torch():
        call = make_torch_call(work[:3], work.targets, sigma=case.sigma)
        calls["PyTorch"] = call
    return _compare(str(case), calls, ALL_DEVICES, rounds)


def compare_choices(case: Case, *, num_candidates: int, rounds: int) -> dict[str, Any]:
    """The winner of K, found without a gradient, beside the minimum over all K."""
    work = _draw_work(case, num_candidates)
    calls = {
        name: _make_call(loss, work, case.sigma)
        for name, loss in (("chosen", _choose_first), ("min", _take_minimum))
    }
    return _compare(f"{case}, K={num_candidates}", calls, "chosen", rounds)


def compare_sizes(case: Case, *, rounds: int) -> dict[str, Any]:
    """A sigma per point, of 0.7 to 2.5 voxels, by levels and exactly; one for all."""
    work = _draw_work(case)
    sizes = np.random.default_rng([SEED, 2]).uniform(0.7, 2.5, case.points)
    calls = {
        name: _make_call(_make_loss(render_ours, method=method), work, sigma)
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


# Axis: what it counts, and the power of it that the run time is expected to follow
# once it dominates. A grid has D³ cells; smoothing by wide, dense kernels takes D⁴.
AXES = {
    "N": ("points", 1),
    "D": ("cells a side", 3),
    "B": ("samples", 1),
    "K": ("candidates, the winner with a gradient", 1),
}


def measure_axis(axis: str, *, plan: Plan) -> dict[str, Any]:
    """Median seconds, forward and backward, for each value of one number of `AXES`.

    The other numbers are those of the plan's base case.
    """
    base, values = plan.scaling_base, plan.scaling[axis]
    subject, order = AXES[axis]
    calls = {}
    for value in values:
        if axis == "K":
            work = _draw_work(base, value)
            calls[str(value)] = _make_call(_choose_first, work, base.sigma)
        else:
            field = {"N": "points", "D": "side", "B": "batch"}[axis]
            case = dataclasses.replace(base, **{field: value})
            calls[str(value)] = prepare_render(case)
    medians = measure_medians(calls, rounds=plan.rounds)
    return {
        "axis": axis,
        "subject": subject,
        "order": order,
        "base": str(base),
        "values": list(values),
        "median_seconds": list(medians.values()),
    }
