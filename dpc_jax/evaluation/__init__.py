"""How good a shape and a pose are: Chamfer distance, pose error, alignment, scores."""

from dpc_jax.evaluation.alignment import align as align
from dpc_jax.evaluation.alignment import align_points as align_points
from dpc_jax.evaluation.alignment import align_poses as align_poses
from dpc_jax.evaluation.candidates import collapse_warning as collapse_warning
from dpc_jax.evaluation.candidates import count_alive as count_alive
from dpc_jax.evaluation.candidates import winner_entropy as winner_entropy
from dpc_jax.evaluation.candidates import winner_share as winner_share
from dpc_jax.evaluation.chamfer import chamfer_distance as chamfer_distance
from dpc_jax.evaluation.pose import pose_accuracy as pose_accuracy
from dpc_jax.evaluation.pose import pose_summary as pose_summary
from dpc_jax.evaluation.pose import rotation_angle_deg as rotation_angle_deg
from dpc_jax.evaluation.scores import score as score
