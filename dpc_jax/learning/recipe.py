"""What is static about a run's steps, and what a step hands on."""

import dataclasses
from typing import Any, NamedTuple

import jax

from dpc_jax.config import Pose, Render, Train
from dpc_jax.learning.schedules import Stage
from dpc_jax.learning.signals import Weights
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.render import Camera


class Recipe(NamedTuple):
    """What is learned and how: the network and what losses need of the config."""

    network: ShapePoseNetwork
    render: Render
    pose: Pose
    train: Train
    spreads_masks: bool

    @property
    def camera(self) -> Camera:
        """Of views that have none of their own."""
        return Camera(self.render.focal_length, self.render.distance)

    @property
    def weights(self) -> Weights:
        """Of the signals."""
        train = self.train
        return Weights(
            train.silhouette_weight,
            train.depth_weight,
            train.color_weight,
            train.background_weight,
            self.spreads_masks,
        )

    def enter(self, stage: Stage) -> "Recipe":
        """The recipe of a stage: in the fine grid half of `choice_top` are compared.

        More candidates find poses while shapes form (docs/log.md), and only cost time
        then.
        """
        if stage.grid == self.render.grid:
            return self
        top = (self.pose.choice_top + 1) // 2
        return self._replace(pose=dataclasses.replace(self.pose, choice_top=top))


class Averages(NamedTuple):
    """Of the batches before; what a step goes on from besides the parameters.

    Attributes:
      covariance: [3, 3] of predicted points, over the last hundred or so batches: its
        principal axes are those of the half turns.
      cost: () of a view; of runs that draw poses, else None.
      frame: what `pose.common_frame` goes by: `choice.common_frame.Frame`, or the
        counts of `choice.colors`; else None.
    """

    covariance: jax.Array
    cost: jax.Array | None = None
    frame: Any = None  # its module is loaded where it is asked for
