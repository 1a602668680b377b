"""The differentiable projection of point clouds."""

from dpc_jax.render import quaternion as quaternion
from dpc_jax.render.batch import project_batch as project_batch
from dpc_jax.render.blocks.capacity import count_blocks as count_blocks
from dpc_jax.render.camera import Camera as Camera
from dpc_jax.render.camera import VoxelGrid as VoxelGrid
from dpc_jax.render.devices import use_all_cores as use_all_cores
from dpc_jax.render.fast.smoothing import smooth as smooth
from dpc_jax.render.fast.splatting import splat as splat
from dpc_jax.render.memory import MemoryEstimate as MemoryEstimate
from dpc_jax.render.memory import estimate_memory as estimate_memory
from dpc_jax.render.object_volume import project_volume as project_volume
from dpc_jax.render.opencv import from_opencv as from_opencv
from dpc_jax.render.opencv import to_opencv as to_opencv
from dpc_jax.render.projection import Projection as Projection
from dpc_jax.render.projection import mass_of_peak as mass_of_peak
from dpc_jax.render.projection import project as project
from dpc_jax.render.projection import voxelize as voxelize
from dpc_jax.render.termination import opacity as opacity
from dpc_jax.render.termination import (
    termination_probabilities as termination_probabilities,
)
