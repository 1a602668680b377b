"""A network with its data sets: prediction, alignment, validation, test."""

from dpc_jax.config import Config
from dpc_jax.data import DataSet
from dpc_jax.evaluation.alignment import MODELS, Alignment, identity_alignment
from dpc_jax.learning.batches import list_extras
from dpc_jax.learning.inference import evaluator
from dpc_jax.learning.inference.predictor import (
    Predictions,
    make_predictor,
    predict_all,
)
from dpc_jax.learning.step import TrainState
from dpc_jax.networks import ShapePoseNetwork
from dpc_jax.run.setup import make_network

_ALIGNING = "aligning"  # training objects that align with those that validate


class Learner:
    """A network with its data sets: what it predicts of them, and how good that is."""

    def __init__(self, config: Config, sets: dict[str, DataSet]):
        """sets: by their splits."""
        self.config, self.sets = config, _add_aligning(config, sets)
        self.network: ShapePoseNetwork = make_network(config)
        self.predictor = make_predictor(self.network, config)
        # Of the last validation: its step, alignment and threshold.
        self._validated: tuple[int, Alignment, float | None] | None = None

    def predict(
        self,
        state: TrainState,
        split: str,
        *,
        threshold: float | None = None,
    ) -> tuple[Predictions, float | None]:
        """Predictions for a split; of voxel models also the threshold of surfaces.

        Points of voxel models are on these surfaces.

        Args:
          threshold: that the validation split, on which it is tuned, has given.
        """
        extras = list_extras(self.config)
        found = predict_all(self.predictor, state, self.sets[split], extras=extras)
        if self.config.network.shape != "voxels":
            return found, None
        # It needs libraries of its own.
        from dpc_jax.learning.inference import volumes

        if split == "val":
            data = self.sets["val"]
            threshold = volumes.find_threshold(
                found, data, lambda shown: self.align((shown, data))
            )
        if threshold is None:
            raise ValueError(
                "Expected the threshold of surfaces in the run's report, but there is "
                "none; start the command that began the run again."
            )
        return volumes.add_points(found, threshold), threshold

    def align(self, *shown: tuple[Predictions, DataSet]) -> Alignment:
        """Canonical alignment, from predictions for data sets that are no test."""
        if self.config.pose.aligned:
            return identity_alignment()  # learned in the data's own frame
        return evaluator.align(*shown)

    def validate(self, state: TrainState) -> dict[str, float]:
        """Metrics on the validation split."""
        predictions, threshold = self.predict(state, "val")
        shown = [(predictions, self.sets["val"])]
        if _ALIGNING in self.sets:
            more, _ = self.predict(state, _ALIGNING, threshold=threshold)
            shown.append((more, self.sets[_ALIGNING]))
        alignment = self.align(*shown)
        self._validated = int(state.step), alignment, threshold
        result = evaluator.score(
            predictions,
            self.sets["val"],
            alignment=alignment,
            poses_given=self.config.pose.known,
            chamfer_views=1,
            has_visible=False,
        )
        return result.metrics

    def predict_test(
        self, state: TrainState
    ) -> tuple[Predictions, Alignment, float | None]:
        """Predictions for the test split, with what the validation split tells of them.

        That is the alignment from the network's frame to the object frame, and the
        threshold of the surfaces of a voxel model. All processes of a job must call it.
        """
        if self._validated is None or self._validated[0] != int(state.step):
            self.validate(state)
        assert self._validated is not None
        _, alignment, threshold = self._validated
        predictions, _ = self.predict(state, "test", threshold=threshold)
        return predictions, alignment, threshold


def _add_aligning(config, sets):
    """The sets, with the first training meshes where few objects validate.

    Of a dozen airplanes of few families half may be learned in a reversed orientation.
    """
    missing = MODELS - len(sets["val"].names)
    if not config.data.meshes or config.pose.aligned or missing <= 0:
        return sets
    return sets | {_ALIGNING: sets["train"].take(missing)}
