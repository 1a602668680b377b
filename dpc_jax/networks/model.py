"""The whole network: image to point cloud and camera pose (§ Network architecture)."""

from typing import Any

import chex
import flax.linen as nn
import jax
import jax.numpy as jnp

from dpc_jax.networks.encoder import TINT, ImageEncoder, measure_tint
from dpc_jax.networks.pose import BoundedHead, PoseSelector


class ShapePoseNetwork(nn.Module):
    """Encoder, shape branch, and pose branches.

    Only what a run learns has parameters: there is no pose branch where poses are
    known, no student where K = 1, and no colours unless asked for.

    Attributes:
      encoder: of images.
      shape: a `ShapeHead`, or the `VoxelHead` or `ViewMapHead` of baselines.
      pose: a `PoseEnsemble`, or the `ViewpointEnsemble` of upright cameras; None where
        poses are known.
      student: a `PoseStudent`, or a `PoseSelector` among the candidates, turned ones
        included; None with one head, which is its own student.
      translation: predicts where in the frame the object is, or None.
      focal: predicts the share by which a view's focal length differs, or None.
      focal_length: from which it differs.
      pose_encoder, judge: of MVC, which predicts poses from features of their own, and
        has a `PoseJudge`; both or neither.
      is_tinted: colours of points are predicted from the mean colour of the image's
        object, too.
      sees_mask: images have a fourth channel, the object's mask. Not in the paper.

    Example:
      >>> network = dpc_jax.ShapePoseNetwork(
      ...     encoder=dpc_jax.ImageEncoder(channels=2, hidden=8),
      ...     shape=dpc_jax.ShapeHead(num_points=50),
      ...     pose=dpc_jax.PoseEnsemble(num_heads=4),
      ...     student=dpc_jax.PoseStudent(),
      ... )
      >>> images = jnp.zeros((1, 16, 16, 3))
      >>> output, parameters = network.init_with_output(jax.random.key(0), images)
      >>> output["points"].shape, output["candidates"].shape
      ((1, 50, 3), (1, 4, 4))
    """

    encoder: ImageEncoder
    shape: Any  # each kind of head has attributes of its own
    pose: Any = None
    student: nn.Module | None = None
    translation: BoundedHead | None = None
    focal: BoundedHead | None = None
    focal_length: float = 1.875
    pose_encoder: ImageEncoder | None = None
    judge: nn.Module | None = None
    is_tinted: bool = False
    sees_mask: bool = False

    @property
    def inputs(self) -> int:
        """How many channels an image has."""
        return 4 if self.sees_mask else 3

    def encode(self, images: jax.Array, *, mix: jax.Array | None = None) -> jax.Array:
        """Images [B, S, S, 3], or 4 with masks, in [-1, 1] to features [B, F].

        F is the encoder's `hidden`, or twice that with a pose encoder, and three more,
        the last ones, where `is_tinted`. `mix` is as of `ImageEncoder`: weights [M, B]
        of mixtures of the images.
        """
        chex.assert_axis_dimension(images, -1, self.inputs)
        features = self.encoder(images, mix=mix)
        if self.pose_encoder is not None:
            others = self.pose_encoder(images, mix=mix)
            features = jnp.concatenate([features, others], axis=-1)
        if self.is_tinted:
            tint = measure_tint(images[..., :3])
            tint = tint if mix is None else jnp.matmul(mix, tint, precision="highest")
            features = jnp.concatenate([features, tint], axis=-1)
        return features

    def predict_shape(self, features: jax.Array) -> dict[str, jax.Array]:
        """Features [B, F] to what the shape head predicts: points, or cells."""
        # The head of points alone takes a tint.
        tint = {"tint": features[..., -TINT:]} if self.is_tinted else {}
        return self.shape(features[..., : self.encoder.hidden], **tint)

    def predict_pose(self, features: jax.Array) -> dict[str, jax.Array]:
        """Features [B, F] to "candidates" [B, K, 4] and the output of the student.

        The latter is "student" [B, 4], or "logits" [B, num_classes] of a student that
        selects. With K = 1 the single regressor is its own student. Where poses are
        known, the dictionary is empty.
        """
        if self.pose is None:
            return {}
        # Of the pose encoder, if there is one.
        features = self._leave_tint(features)[..., -self.encoder.hidden :]
        poses = self.pose(features)
        if self.student is None:
            return {"candidates": poses, "student": poses[:, 0]}
        output = "logits" if isinstance(self.student, PoseSelector) else "student"
        return {"candidates": poses, output: self.student(features)}

    def predict_camera(self, features: jax.Array) -> dict[str, jax.Array]:
        """Features [B, F] to "translations" [B, 3] and "focal_lengths" [B], if learned.

        Translations are those of the object in the camera frame, in box diagonals.
        """
        output, features = {}, self._leave_tint(features)
        if self.translation is not None:
            output["translations"] = self.translation(features)
        if self.focal is not None:
            shares = 1 + self.focal(features)[:, 0]
            output["focal_lengths"] = self.focal_length * shares
        return output

    def _leave_tint(self, features):
        """The features but those that colours alone see."""
        return features[..., :-TINT] if self.is_tinted else features

    def __call__(self, images: jax.Array) -> dict[str, jax.Array]:
        """All predictions for images [B, S, S, 3], or 4; also makes the parameters."""
        features = self.encode(images)
        poses = self.predict_pose(features) | self.predict_camera(features)
        if self.is_initializing() and self.judge is not None:
            self.judge(poses["candidates"][:, 0])  # makes its parameters
        return self.predict_shape(features) | poses
