"""How good a shape and a pose are: Chamfer distance, pose error, alignment, scores."""

from dpc_jax.evaluation.alignment import align as align
from dpc_jax.evaluation.chamfer import chamfer_distance as chamfer_distance
from dpc_jax.evaluation.pose import pose_summary as pose_summary
from dpc_jax.evaluation.rotations import rotation_angle_deg as rotation_angle_deg
