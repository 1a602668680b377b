"""The whole network: image to point cloud and camera pose (§ Network architecture)."""

from typing import Any

import chex
import flax.linen as nn
import jax
import jax.numpy as jnp

from dpc_jax.networks.encoder import TINT, ImageEncoder, measure_tint
from dpc_jax.networks.pose import (
    FOCAL_RANGE,
    TRANSLATION_RANGE,
    BoundedHead,
    PoseEnsemble,
    PoseSelector,
    PoseStudent,
)
from dpc_jax.networks.shape import ShapeHead


class ShapePoseNetwork(nn.Module):
    """Encoder, shape branch, and pose branches.

    Only what a run learns has parameters: there is no pose branch where poses are known
    (`num_heads` 0), no student where K = 1, and no colours unless asked for.

    Attributes:
      num_points, shape_hidden, has_color, scale_fixed, point_size, first_size: of the
        `ShapeHead`.
      shape_kind: what the shape branch predicts, see `config.network.shape`.
      grid: side of volumes and maps.
      contains_voxels: is_contained of the `VoxelHead`.
      map_focal_length, map_distance: of the `ViewMapHead`.
      viewpoints: lowest and highest elevation, degrees, of heads that predict azimuth
        and elevation (`ViewpointEnsemble`); None for heads that predict quaternions.
      samples_poses: as MVC has a `PoseJudge`, and predicts poses from features of an
        encoder of their own, which come behind those of shapes.
      num_heads: K, the number of pose predictors; 0 where poses are known.
      channels, hidden, normalize, blocks: of the `ImageEncoder`.
      num_classes: how many candidates the student selects from, turned ones included;
        0 for the paper's student, which regresses a pose.
      student_width: width of the student's own layers.
      spreads, head_layers, pose_slope: see `PoseEnsemble`.
      has_translation: predict where in the frame the object is.
      focal_length: around which that of a view is predicted; 0: it is not.
      is_tinted: colours of points are predicted from the mean colour of the image's
        object, too.
      sees_mask: images have a fourth channel, the object's mask. Not in the paper.
    """

    num_points: int
    num_heads: int
    channels: int = 16
    hidden: int = 1024
    shape_hidden: int = 1024
    normalize: bool = False
    has_color: bool = False
    num_classes: int = 0
    student_width: int = 32
    spreads: bool = False
    blocks: int = 0
    head_layers: int = 2
    pose_slope: float = 0.2
    scale_fixed: float = 0.0
    point_size: str = ""
    first_size: float = 0.05
    has_translation: bool = False
    focal_length: float = 0.0
    shape_kind: str = "points"
    grid: int = 32
    contains_voxels: bool = False
    map_focal_length: float = 1.875
    map_distance: float = 2.0
    viewpoints: tuple[float, float] | None = None
    samples_poses: bool = False
    is_tinted: bool = False
    sees_mask: bool = False

    @property
    def inputs(self) -> int:
        """How many channels an image has."""
        return 4 if self.sees_mask else 3

    def setup(self) -> None:
        """Make the branches that this run learns."""
        self.encoder = self._make_encoder()
        self.shape = self._make_shape_head()
        if self.num_heads:
            self.pose = self._make_pose_heads()
        if self.samples_poses:
            from dpc_jax.networks.viewpoints import PoseJudge  # where asked

            self.pose_encoder, self.judge = self._make_encoder(), PoseJudge()
        layers = self.hidden, self.student_width, self.pose_slope
        if self.num_heads > 1 and self.num_classes:
            self.student = PoseSelector(self.num_classes, *layers)
        elif self.num_heads > 1:
            self.student = PoseStudent(*layers)
        if self.has_translation:
            self.translation = BoundedHead(outputs=3, bound=TRANSLATION_RANGE)
        if self.focal_length:
            self.focal = BoundedHead(outputs=1, bound=FOCAL_RANGE)

    def _make_encoder(self):
        return ImageEncoder(self.channels, self.hidden, self.normalize, self.blocks)

    def _make_pose_heads(self):
        if self.viewpoints:
            from dpc_jax.networks.viewpoints import ViewpointEnsemble  # where asked

            return ViewpointEnsemble(
                self.num_heads, self.viewpoints, self.hidden, self.pose_slope
            )
        return PoseEnsemble(
            num_heads=self.num_heads,
            hidden=self.hidden,
            spreads=self.spreads,
            layers=self.head_layers,
            slope=self.pose_slope,
        )

    def _make_shape_head(self):
        if self.shape_kind == "voxels":
            from dpc_jax.networks.voxels import VoxelHead  # of baselines alone

            return VoxelHead(
                side=self.grid,
                has_color=self.has_color,
                normalize=self.normalize,
                is_contained=self.contains_voxels,
            )
        if self.shape_kind == "maps":
            from dpc_jax.networks.view_maps import ViewMapHead  # of a baseline

            return ViewMapHead(
                side=self.grid,
                focal_length=self.map_focal_length,
                distance=self.map_distance,
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
        """Images [B, S, S, 3], or 4 with masks, in [-1, 1] to features [B, F].

        F is `hidden`, or twice that with a pose encoder, and three more, the last ones,
        where `is_tinted`. `mix` is as of `ImageEncoder`: weights [M, B] of mixtures of
        the images.
        """
        chex.assert_axis_dimension(images, -1, self.inputs)
        features = self.encoder(images, mix=mix)
        if self.samples_poses:
            others = self.pose_encoder(images, mix=mix)
            features = jnp.concatenate([features, others], axis=-1)
        if self.is_tinted:
            tint = measure_tint(images[..., :3])
            tint = tint if mix is None else jnp.matmul(mix, tint, precision="highest")
            features = jnp.concatenate([features, tint], axis=-1)
        return features

    def predict_shape(self, features: jax.Array) -> dict[str, jax.Array]:
        """Features [B, F] to what the shape head predicts: points, or cells."""
        head: Any = self.shape  # that of points alone takes a tint
        tint = {"tint": features[..., -TINT:]} if self.is_tinted else {}
        return head(features[..., : self.hidden], **tint)

    def predict_pose(self, features: jax.Array) -> dict[str, jax.Array]:
        """Features [B, F] to "candidates" [B, K, 4] and the output of the student.

        The latter is "student" [B, 4], or "logits" [B, num_classes] of a student that
        selects. With K = 1 the single regressor is its own student. Where poses are
        known, the dictionary is empty.
        """
        if not self.num_heads:
            return {}
        features = self._leave_tint(features)
        features = features[..., -self.hidden :]  # of the pose encoder, if there is one
        poses = self.pose(features)
        if self.num_heads == 1:
            return {"candidates": poses, "student": poses[:, 0]}
        output = "logits" if self.num_classes else "student"
        return {"candidates": poses, output: self.student(features)}

    def predict_camera(self, features: jax.Array) -> dict[str, jax.Array]:
        """Features [B, F] to "translations" [B, 3] and "focal_lengths" [B], if learned.

        Translations are those of the object in the camera frame, in box diagonals.
        """
        output, features = {}, self._leave_tint(features)
        if self.has_translation:
            output["translations"] = self.translation(features)
        if self.focal_length:
            output["focal_lengths"] = (
                self.focal_length * (1 + self.focal(features))[:, 0]
            )
        return output

    def _leave_tint(self, features):
        """The features but those that colours alone see."""
        return features[..., :-TINT] if self.is_tinted else features

    def judge_poses(self, quaternions: jax.Array) -> jax.Array:
        """Unit quaternions [n, 4] to logits [n], see `PoseJudge`."""
        return self.judge(quaternions)

    def __call__(self, images: jax.Array) -> dict[str, jax.Array]:
        """All predictions for images [B, S, S, 3], or 4; also makes the parameters."""
        features = self.encode(images)
        poses = self.predict_pose(features) | self.predict_camera(features)
        if self.is_initializing() and self.samples_poses:
            self.judge_poses(poses["candidates"][:, 0])  # makes its parameters
        return self.predict_shape(features) | poses
