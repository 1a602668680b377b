"""The whole network: image to point cloud and camera pose (§ Network architecture)."""

from typing import Any

import flax.linen as nn
import jax

from dpc_jax.networks.camera import FOCAL_RANGE, TRANSLATION_RANGE, BoundedHead
from dpc_jax.networks.encoder import ImageEncoder
from dpc_jax.networks.pose import PoseEnsemble, PoseSelector, PoseStudent
from dpc_jax.networks.shape import ShapeHead
from dpc_jax.networks.voxels import VoxelHead


class ShapePoseNetwork(nn.Module):
    """Encoder, shape branch, and pose branches.

    Only what a run learns has parameters: there is no pose branch where poses are known
    (`candidates` 0), no student where K = 1, and no colours unless asked for.

    Attributes:
      num_points, shape_hidden, has_color, scale_fixed, point_size, first_size: of the
        `ShapeHead`.
      voxels: side of the volume that the `VoxelHead` predicts; 0 for points.
      voxel_channels: of it.
      candidates: K, the number of pose predictors; 0 where poses are known.
      channels, hidden, normalize, blocks: of the `ImageEncoder`.
      num_classes: how many candidates the student selects from, turned ones included;
        0 for the paper's student, which regresses a pose.
      student_width: width of the student's own layers.
      spread, head_layers, pose_slope: see `PoseEnsemble`.
      has_translation: predict where in the frame the object is.
      focal_length: around which that of a view is predicted; 0: it is not.
    """

    num_points: int
    candidates: int
    channels: int = 16
    hidden: int = 1024
    shape_hidden: int = 1024
    normalize: bool = False
    has_color: bool = False
    num_classes: int = 0
    student_width: int = 32
    spread: str = ""
    blocks: int = 0
    head_layers: int = 2
    pose_slope: float = 0.2
    scale_fixed: float = 0.0
    point_size: str = ""
    first_size: float = 0.05
    has_translation: bool = False
    focal_length: float = 0.0
    voxels: int = 0
    voxel_channels: int = 16

    def setup(self) -> None:
        """Make the branches that this run learns."""
        self.encoder = ImageEncoder(
            channels=self.channels,
            hidden=self.hidden,
            normalize=self.normalize,
            blocks=self.blocks,
        )
        self.shape = self._make_shape_head()
        if self.candidates:
            self.pose = PoseEnsemble(
                candidates=self.candidates,
                hidden=self.hidden,
                spread=self.spread,
                layers=self.head_layers,
                slope=self.pose_slope,
            )
        student: dict[str, Any] = {
            "hidden": self.hidden,
            "width": self.student_width,
            "slope": self.pose_slope,
        }
        if self.candidates > 1 and self.num_classes:
            self.student = PoseSelector(num_classes=self.num_classes, **student)
        elif self.candidates > 1:
            self.student = PoseStudent(**student)
        if self.has_translation:
            self.translation = BoundedHead(outputs=3, bound=TRANSLATION_RANGE)
        if self.focal_length:
            self.focal = BoundedHead(outputs=1, bound=FOCAL_RANGE)

    def _make_shape_head(self):
        if self.voxels:
            return VoxelHead(
                side=self.voxels,
                channels=self.voxel_channels,
                has_color=self.has_color,
                normalize=self.normalize,
            )
        return ShapeHead(
            num_points=self.num_points,
            hidden=self.shape_hidden,
            has_color=self.has_color,
            scale_fixed=self.scale_fixed,
            point_size=self.point_size,
            first_size=self.first_size,
        )

    def encode(self, images: jax.Array, *, mix: jax.Array | None = None) -> jax.Array:
        """Images [B, S, S, 3] in [-1, 1] to features [B, hidden].

        `mix` is as of `ImageEncoder`: weights [M, B] of mixtures of the images.
        """
        return self.encoder(images, mix=mix)

    def predict_shape(self, features: jax.Array) -> dict[str, jax.Array]:
        """Features [B, F] to what the shape head predicts: points, or cells."""
        return self.shape(features)

    def predict_pose(self, features: jax.Array) -> dict[str, jax.Array]:
        """Features [B, F] to "candidates" [B, K, 4] and the output of the student.

        The latter is "student" [B, 4], or "logits" [B, num_classes] of a student that
        selects. With K = 1 the single regressor is its own student. Where poses are
        known, the dictionary is empty.
        """
        if not self.candidates:
            return {}
        poses = self.pose(features)
        if self.candidates == 1:
            return {"candidates": poses, "student": poses[:, 0]}
        output = "logits" if self.num_classes else "student"
        return {"candidates": poses, output: self.student(features)}

    def predict_camera(self, features: jax.Array) -> dict[str, jax.Array]:
        """Features [B, F] to "translations" [B, 3] and "focal_lengths" [B], if learned.

        Translations are those of the object in the camera frame, in box diagonals.
        """
        output = {}
        if self.has_translation:
            output["translations"] = self.translation(features)
        if self.focal_length:
            output["focal_lengths"] = (
                self.focal_length * (1 + self.focal(features))[:, 0]
            )
        return output

    def __call__(self, images: jax.Array) -> dict[str, jax.Array]:
        """All predictions for images [B, S, S, 3]; also initialises the parameters."""
        features = self.encode(images)
        poses = self.predict_pose(features) | self.predict_camera(features)
        return self.predict_shape(features) | poses
