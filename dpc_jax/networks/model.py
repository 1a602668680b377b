"""The whole network: image to point cloud and camera pose (§ Network architecture)."""

import chex
import flax.linen as nn

from dpc_jax.networks.encoder import ImageEncoder
from dpc_jax.networks.pose import PoseEnsemble, PoseSelector, PoseStudent
from dpc_jax.networks.shape import ShapeHead


class ShapePoseNetwork(nn.Module):
    """Encoder, shape branch, and pose branches.

    What a run does not learn has no parameters: no pose branch where poses are known
    (`num_candidates` 0), no student where K = 1, no colours unless asked.

    Attributes:
      num_points: N.
      num_candidates: K; 0 where poses are known.
      channels, hidden, normalize: of the encoder.
      shape_hidden: width of the shape branch's hidden layer.
      has_color: predict colours.
      num_classes: how many candidates the student selects from, turned ones included;
        0 for the paper's student, which regresses a pose.
      student_width: of the student's own layers.
      spread_poses: where the heads start, see `PoseEnsemble`.
    """

    num_points: int
    num_candidates: int
    channels: int = 16
    hidden: int = 1024
    shape_hidden: int = 1024
    normalize: bool = False
    has_color: bool = False
    num_classes: int = 0
    student_width: int = 32
    spread_poses: str = ""

    def setup(self):
        self.encoder = ImageEncoder(
            channels=self.channels, hidden=self.hidden, normalize=self.normalize
        )
        self.shape = ShapeHead(
            num_points=self.num_points,
            hidden=self.shape_hidden,
            has_color=self.has_color,
        )
        if self.num_candidates:
            self.pose = PoseEnsemble(
                num_candidates=self.num_candidates,
                hidden=self.hidden,
                spread=self.spread_poses,
            )
        if self.num_candidates > 1 and self.num_classes:
            self.student = PoseSelector(
                num_classes=self.num_classes,
                hidden=self.hidden,
                width=self.student_width,
            )
        elif self.num_candidates > 1:
            self.student = PoseStudent(hidden=self.hidden, width=self.student_width)

    def encode(self, images: chex.Array) -> chex.Array:
        """Images [B, S, S, 3] in [-1, 1] to features [B, hidden]."""
        return self.encoder(images)

    def predict_shape(self, features: chex.Array) -> dict[str, chex.Array]:
        """Features [B, F] to points [B, N, 3], scale [B] and colors [B, N, 3]."""
        return self.shape(features)

    def predict_pose(self, features: chex.Array) -> dict[str, chex.Array]:
        """Features [B, F] to candidates [B, K, 4] and what the student says.

        That is "student" [B, 4], or "logits" [B, num_classes] of one that selects.
        With K = 1 the single regressor is its own student; without poses to learn the
        dictionary is empty.
        """
        if not self.num_candidates:
            return {}
        candidates = self.pose(features)
        if self.num_candidates == 1:
            return {"candidates": candidates, "student": candidates[:, 0]}
        says = "logits" if self.num_classes else "student"
        return {"candidates": candidates, says: self.student(features)}

    def __call__(self, images: chex.Array) -> dict[str, chex.Array]:
        """All predictions for images [B, S, S, 3]; used to make the parameters."""
        features = self.encode(images)
        return self.predict_shape(features) | self.predict_pose(features)
