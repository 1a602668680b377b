"""The engine beside its peers: the same work, the same run, and the same gradients."""

import functools
import importlib.util
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.learning.hindsight import choose_candidate
from dpc_jax.learning.losses import reprojection_loss
from dpc_jax.measure.benchmark import plain_peer
from dpc_jax.measure.benchmark.plan import Case
from dpc_jax.measure.timing import take_medians, time_interleaved
from dpc_jax.render import Camera, VoxelGrid, project


def draw_work(case: Case, *, seed: int):
    """Points, quaternions, masses and targets of a case; numpy, float32."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.4, 0.4, (case.batch, case.points, 3))
    quaternions = rng.normal(size=(case.batch, 4))
    # A mean occupancy of 0.03, some of the middle clipped.
    masses = np.full(case.batch, 0.03 * case.side**3 / case.points)
    targets = rng.uniform(size=(case.batch, case.side, case.side))
    return tuple(a.astype("f4") for a in (points, quaternions, masses, targets))


def render_ours(points, rotation, mass, sigma, *, side, method="auto"):
    """Silhouette of one cloud by `project`."""
    grid = VoxelGrid(side)
    image = project(points, rotation, sigma=sigma, scale=mass, grid=grid, method=method)
    return image.silhouette


def make_jax_call(render, points, quaternions, masses, targets, sigma, **static):
    """A call that gives the gradients of points, quaternions and masses.

    Args:
      render: a module's function that makes the silhouette of one sample from its
        arrays and `static`; samples go one after the other.
    """
    gradient = _compile_gradient(render, tuple(sorted(static.items())))
    inputs = tuple(jnp.asarray(a) for a in (points, quaternions, masses))
    rest = jnp.asarray(targets), jnp.asarray(sigma, jnp.float32)
    return lambda: gradient(inputs, *rest)


@functools.lru_cache
def _compile_gradient(render, static):
    def compute_loss(inputs, targets, sigma):
        images = jax.lax.map(lambda one: render(*one, sigma, **dict(static)), inputs)
        return jnp.sum((images - targets) ** 2)

    return jax.jit(jax.grad(compute_loss))


def compare_with_peers(case: Case, *, rounds: int, seed: int) -> dict[str, Any]:
    """Silhouette, forward and backward, beside the plain ways to write it."""
    work = draw_work(case, seed=seed)
    calls = {
        "ours": make_jax_call(render_ours, *work, case.sigma, side=case.side),
        "plain JAX": make_jax_call(
            plain_peer.render_plain, *work, case.sigma, side=case.side
        ),
    }
    if has_torch():
        from dpc_jax.measure.benchmark import torch_peer

        calls["PyTorch"] = torch_peer.make_call(*work, sigma=case.sigma)
    return _compare(str(case), calls, "ours", rounds)


def has_torch() -> bool:
    """Whether PyTorch is installed; asking does not load it."""
    return importlib.util.find_spec("torch") is not None


def compare_sizes(case: Case, *, rounds: int, seed: int) -> dict[str, Any]:
    """A sigma for each point (`gaussian`) beside one for all (`trilinear`)."""
    work = draw_work(case, seed=seed)
    spread = np.random.default_rng([seed, 1]).uniform(0.5, 1.5, case.points)
    sigmas = case.sigma * spread
    calls = {
        method: make_jax_call(render_ours, *work, sigma, side=case.side, method=method)
        for method, sigma in (("trilinear", case.sigma), ("gaussian", sigmas))
    }
    # Other sizes, other gradients: there is nothing to compare.
    return _compare(str(case), calls, "trilinear", rounds, has_one_gradient=False)


def compare_choices(
    case: Case, *, num_candidates: int, rounds: int, seed: int
) -> dict[str, Any]:
    """The winner of K candidates, found without a gradient, beside min over all."""
    points, _, masses, targets = draw_work(case, seed=seed)
    rng = np.random.default_rng([seed, 1])
    candidates = rng.normal(size=(case.batch, num_candidates, 4)).astype("f4")
    arrays = (points, candidates, masses, targets, case.sigma)
    calls = {
        "chosen": make_choice_call("chosen", *arrays),
        "min, one by one": make_choice_call("min, one by one", *arrays),
        "min, all at once": make_choice_call("min, all at once", *arrays),
    }
    return _compare(f"{case}, K={num_candidates}", calls, "chosen", rounds)


def make_choice_call(how, points, candidates, masses, targets, sigma):
    """A call that gives the gradients of points and candidates.

    Args:
      how: "chosen" (hindsight choice, then one render with a gradient), or the plain
        minimum over renders with a gradient, "min, one by one" or "min, all at once".
      points: [B, N, 3]. candidates: [B, K, 4]. masses: [B]. targets: [B, D, D].
    """
    gradient = _compile_choice(how)
    samples = tuple(jnp.asarray(a) for a in (points, candidates, masses, targets))
    sigma = jnp.asarray(sigma, jnp.float32)
    return lambda: gradient(samples[:2], samples[2:], sigma)


@functools.lru_cache
def _compile_choice(how):
    def compute_loss(points, candidates, mass, target, sigma):
        def compute_one(candidate):
            image = render_ours(points, candidate, mass, sigma, side=target.shape[0])
            return reprojection_loss(image, target)

        if how == "min, one by one":
            return jnp.min(jax.lax.map(compute_one, candidates))
        if how == "min, all at once":
            return jnp.min(jax.vmap(compute_one)(candidates))
        still = jax.lax.stop_gradient((points, mass, candidates))
        best = choose_candidate(*still, target, sigma=sigma, camera=Camera())
        return compute_one(candidates[best])

    def compute_all(moving, fixed, sigma):
        samples = (*moving, *fixed)
        losses = jax.lax.map(lambda one: compute_loss(*one, sigma), samples)
        return jnp.sum(losses)

    return jax.jit(jax.grad(compute_all))


def _compare(name, calls, ours, rounds, *, has_one_gradient=True):
    """Medians, ratios to ours, and how far each gradient is from ours."""
    differences = {}
    if has_one_gradient:
        own = calls[ours]()
        differences = {
            peer: [
                measure_distance(np.asarray(value), np.asarray(reference, np.float64))
                for value, reference in zip(call(), own, strict=True)
            ]
            for peer, call in calls.items()
            if peer != ours
        }
    seconds = time_interleaved(calls, rounds=rounds)
    medians = take_medians(seconds)
    return {
        "case": name,
        "ours": ours,
        "median_seconds": medians,
        "seconds": seconds,
        "ratio_to_ours": {
            peer: medians[peer] / medians[ours] for peer in calls if peer != ours
        },
        "gradient_difference": differences,
    }


def measure_distance(value: np.ndarray, reference: np.ndarray) -> float:
    """Relative L2 distance; 0 where both are zero, infinite where one is."""
    distance = np.linalg.norm(np.asarray(value, np.float64) - reference)
    size = np.linalg.norm(reference)
    if size == 0:
        return 0.0 if distance == 0 else float("inf")
    return float(distance / size)
