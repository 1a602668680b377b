"""Shape and pose from silhouettes with differentiable point clouds, in JAX.

`dpc_jax.project` renders a point cloud; the networks, losses and metrics stand alone
too. Every name is loaded when it is first used, so that a program pays only for what it
calls: rendering needs jax, networks flax, metrics scipy, and the data tools none of
them.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dpc_jax.evaluation import align as align
    from dpc_jax.evaluation import chamfer_distance as chamfer_distance
    from dpc_jax.evaluation import pose_summary as pose_summary
    from dpc_jax.evaluation import rotation_angle_deg as rotation_angle_deg
    from dpc_jax.learning.choice.hindsight import choose_candidate as choose_candidate
    from dpc_jax.learning.fitting.object_fit import Fit as Fit
    from dpc_jax.learning.fitting.object_fit import FitSettings as FitSettings
    from dpc_jax.learning.fitting.object_fit import fit as fit
    from dpc_jax.learning.losses import reprojection_loss as reprojection_loss
    from dpc_jax.learning.losses import student_loss as student_loss
    from dpc_jax.networks import ImageEncoder as ImageEncoder
    from dpc_jax.networks import PoseEnsemble as PoseEnsemble
    from dpc_jax.networks import PoseStudent as PoseStudent
    from dpc_jax.networks import ShapeHead as ShapeHead
    from dpc_jax.networks import ShapePoseNetwork as ShapePoseNetwork
    from dpc_jax.render import Camera as Camera
    from dpc_jax.render import MemoryEstimate as MemoryEstimate
    from dpc_jax.render import Projection as Projection
    from dpc_jax.render import VoxelGrid as VoxelGrid
    from dpc_jax.render import count_blocks as count_blocks
    from dpc_jax.render import estimate_memory as estimate_memory
    from dpc_jax.render import from_opencv as from_opencv
    from dpc_jax.render import mass_of_peak as mass_of_peak
    from dpc_jax.render import opacity as opacity
    from dpc_jax.render import project as project
    from dpc_jax.render import project_batch as project_batch
    from dpc_jax.render import project_volume as project_volume
    from dpc_jax.render import quaternion as quaternion
    from dpc_jax.render import smooth as smooth
    from dpc_jax.render import splat as splat
    from dpc_jax.render import termination_probabilities as termination_probabilities
    from dpc_jax.render import to_opencv as to_opencv
    from dpc_jax.render import use_all_cores as use_all_cores
    from dpc_jax.render import voxelize as voxelize

_MODULES = {
    "dpc_jax.evaluation": "align chamfer_distance pose_summary rotation_angle_deg",
    "dpc_jax.learning.choice.hindsight": "choose_candidate",
    "dpc_jax.learning.fitting.object_fit": "Fit FitSettings fit",
    "dpc_jax.learning.losses": "reprojection_loss student_loss",
    "dpc_jax.networks": (
        "ImageEncoder PoseEnsemble PoseStudent ShapeHead ShapePoseNetwork"
    ),
    "dpc_jax.render": (
        "Camera MemoryEstimate Projection VoxelGrid count_blocks "
        "estimate_memory from_opencv mass_of_peak opacity project project_batch "
        "project_volume quaternion smooth splat termination_probabilities to_opencv "
        "use_all_cores voxelize"
    ),
}
# Public name: the module that it is loaded from.
_NAMES = {name: module for module in _MODULES for name in _MODULES[module].split()}


def __getattr__(name: str):
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("dpc_jax")
    if name in _NAMES:
        try:
            return getattr(importlib.import_module(_NAMES[name]), name)
        except ModuleNotFoundError as error:
            if error.name in ("flax", "optax"):
                error.msg = (
                    f"dpc_jax.{name} needs {error.name}, but it is not installed; "
                    "pip install 'dpc_jax[learn]' brings it."
                )
            raise
    raise AttributeError(f"module 'dpc_jax' has no attribute {name!r}")


def __dir__():
    return sorted([*globals(), *_NAMES, "__version__"])
