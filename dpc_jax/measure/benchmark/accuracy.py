"""Error against run time: settings of the projection beside a finer, exact one.

Results are compared in a form that does not depend on the grid: the silhouette in
blocks of the coarsest grid's pixels, and the gradient, to the points, of its squared
difference from another pose's silhouette. On a grid r times finer a point has r times
the sigma and r² times the mass, in voxels: the optical depth along a ray stays the
same, so that results converge.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dpc_jax.measure.benchmark.plan import Plan
from dpc_jax.measure.benchmark.speed import measure_distance
from dpc_jax.measure.scenes import Scene
from dpc_jax.measure.timing import measure_medians
from dpc_jax.render import VoxelGrid, project

_MASS_SIDE = 64  # scenes give their mass for a grid of this many cells a side
# Name, method and dtype.
FAMILIES = (
    ("trilinear", "trilinear", "float32"),
    ("trilinear, bfloat16", "trilinear", "bfloat16"),
    ("quadratic", "quadratic", "float32"),
    ("cubic", "cubic", "float32"),
    ("gaussian", "gaussian", "float32"),
)


class Setting(NamedTuple):
    """One way to render."""

    family: str  # name of the settings that differ from this one in the grid alone
    method: str  # of `project`
    dtype: str
    side: int  # cells of the grid along each axis

    @property
    def label(self) -> str:
        """Its name."""
        return f"{self.family}, {self.side}³"


@jax.enable_x64(True)  # otherwise float64 is computed in float32
def measure_scene(
    scene: Scene, sigma: float, *, plan: Plan, settings: Sequence[Setting]
) -> list[dict[str, Any]]:
    """Errors and run times of all settings on one scene, which take turns.

    Sigma is in voxels of the plan's base grid. The record of a setting holds its errors
    against the fine reference, and the seconds of the image and of image and gradient.
    """
    target = _compute_target(scene, sigma, plan)
    calls = {s.label: _prepare(scene, sigma, s, plan, target) for s in settings}
    times = {
        kind: measure_medians(
            {label: pair[i] for label, pair in calls.items()},
            rounds=plan.rounds,
            budget_seconds=plan.budget_seconds,
        )
        for i, kind in enumerate(("image", "gradient"))
    }
    exact = _compute_exact(scene, sigma, plan, target)
    records = []
    for setting in settings:
        image, (gradient, _) = (call() for call in calls[setting.label])
        record: dict[str, Any] = {"scene": scene.name, "sigma": sigma}
        record |= {"family": setting.family, "setting": setting.label}
        for kind, found in (("image", image), ("gradient", gradient)):
            record[f"{kind}_error"] = measure_distance(found, exact[kind])
            record[f"{kind}_seconds"] = times[kind][setting.label]
        records.append(record)
    return records


def _prepare(scene, sigma, setting, plan, target) -> tuple[Callable, Callable]:
    """Calls that give the image, and the gradient with the image, of a setting."""
    image, gradient = _make_programs(setting.method, setting.side, min(plan.sides))
    # Grids are compared by how near they come to the same image, so the optical depth
    # along a ray has to stay. Learning keeps the density instead.
    mass = scene.mass * (setting.side / _MASS_SIDE) ** 2
    sigma = sigma * setting.side / plan.base_side
    values = (scene.points, scene.pose, mass, sigma, target)
    values = [jnp.asarray(value, setting.dtype) for value in values]
    return functools.partial(image, *values[:4]), functools.partial(gradient, *values)


@functools.lru_cache
def _make_programs(method, side, blocks):
    """Compiled once for all scenes: sigma, mass and target are inputs."""

    def render(points, pose, mass, sigma):
        looks = {"grid": VoxelGrid(side), "method": method}
        image = project(points, pose, sigma=sigma, scale=mass, **looks)
        assert image.silhouette is not None
        tiles = image.silhouette.reshape(blocks, side // blocks, blocks, side // blocks)
        return jnp.mean(tiles, axis=(1, 3))

    def compute_loss(points, pose, mass, sigma, target):
        image = render(points, pose, mass, sigma)
        return jnp.sum((image - target) ** 2), image

    return jax.jit(render), jax.jit(jax.grad(compute_loss, has_aux=True))


def _compute_exact(scene, sigma, plan, target) -> dict[str, np.ndarray]:
    """Image [C, C] and gradient [N, 3] of the gaussian method in float64."""
    setting = Setting("exact", "gaussian", "float64", plan.reference_side)
    _, call = _prepare(scene, sigma, setting, plan, target)
    gradient, image = call()
    return {"image": np.asarray(image), "gradient": np.asarray(gradient)}


def _compute_target(scene, sigma, plan) -> np.ndarray:
    """An image from the other pose. Any would do, so this is the cheapest."""
    turned = scene._replace(pose=scene.target_pose)
    setting = Setting("target", "trilinear", "float32", plan.base_side)
    image, _ = _prepare(turned, sigma, setting, plan, np.zeros(()))
    return np.asarray(image(), np.float64)


def take_scenes_together(records: list[dict]) -> list[dict]:
    """Medians over the scenes of every number, for each setting and sigma."""
    groups: dict[tuple, list[dict]] = {}
    for record in records:
        groups.setdefault((record["sigma"], record["setting"]), []).append(record)
    together = []
    for group in groups.values():
        names = [name for name in group[0] if name.endswith(("seconds", "error"))]
        medians = {n: float(np.median([r[n] for r in group])) for n in names}
        together.append(group[0] | medians)
    return together
