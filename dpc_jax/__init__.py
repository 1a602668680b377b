"""Shape and pose from silhouettes with differentiable point clouds, in JAX.

`dpc_jax.project` renders a point cloud; the networks, losses and metrics stand alone
too. Metrics load scipy when first used.
"""

import importlib
import importlib.metadata

from dpc_jax.render import Camera as Camera
from dpc_jax.render import MemoryEstimate as MemoryEstimate
from dpc_jax.render import Projection as Projection
from dpc_jax.render import VoxelGrid as VoxelGrid
from dpc_jax.render import compensate_widening as compensate_widening
from dpc_jax.render import estimate_memory as estimate_memory
from dpc_jax.render import mass_of_peak as mass_of_peak
from dpc_jax.render import opacity as opacity
from dpc_jax.render import project as project
from dpc_jax.render import quaternion as quaternion
from dpc_jax.render import smooth as smooth
from dpc_jax.render import splat as splat
from dpc_jax.render import termination_probabilities as termination_probabilities
from dpc_jax.render import voxelize as voxelize

# Name to module, loaded when first asked for: flax, optax and scipy cost import time
# that a caller of `project` need not pay.
_LATER = {
    "ImageEncoder": "dpc_jax.networks",
    "PoseEnsemble": "dpc_jax.networks",
    "PoseStudent": "dpc_jax.networks",
    "ShapeHead": "dpc_jax.networks",
    "ShapePoseNetwork": "dpc_jax.networks",
    "reprojection_loss": "dpc_jax.learning.losses",
    "student_loss": "dpc_jax.learning.losses",
    "choose_candidate": "dpc_jax.learning.hindsight",
    "align": "dpc_jax.evaluation",
    "chamfer_distance": "dpc_jax.evaluation",
    "pose_summary": "dpc_jax.evaluation",
    "rotation_angle_deg": "dpc_jax.evaluation",
}

__version__ = importlib.metadata.version("dpc_jax")


def __getattr__(name: str):
    if name in _LATER:
        return getattr(importlib.import_module(_LATER[name]), name)
    raise AttributeError(f"module 'dpc_jax' has no attribute {name!r}")


def __dir__():
    return sorted([*globals(), *_LATER])
