"""The networks of the paper, in flax linen."""

from dpc_jax.networks.encoder import ImageEncoder as ImageEncoder
from dpc_jax.networks.model import ShapePoseNetwork as ShapePoseNetwork
from dpc_jax.networks.pose import PoseEnsemble as PoseEnsemble
from dpc_jax.networks.pose import PoseStudent as PoseStudent
from dpc_jax.networks.shape import ShapeHead as ShapeHead
