"""Shapes that the last checkpoint of a run predicts, of validation or of images."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.config import replace_fields
from dpc_jax.data.arrays import DataSet, Stack
from dpc_jax.data.sets.photographs import Photographs, read_photographs
from dpc_jax.evaluation.alignment import align_points, align_poses
from dpc_jax.learning.inference.predictor import (
    Predictions,
    arrange_views,
    make_predictor,
    predict_all,
)
from dpc_jax.outputs import show_text
from dpc_jax.run.prediction import knows_distance, make_spec
from dpc_jax.run.prediction.objects import make_dataset, place_photographs
from dpc_jax.run.process import prepare_process
from dpc_jax.run.trained import load_checkpoint, load_split
from dpc_jax.run.viewing import Candidates, ShownObject, ShownView
from dpc_jax.run.workdir import read_config

_OBJECTS = 12  # of validation: with five views each they are one batch


class NetworkShapes:
    """The network of a workdir, whose run may still be training."""

    def __init__(self, workdir: Path, data: Path | None):
        """data: folder of rendered sets; None for that of the config."""
        self._workdir, config = workdir, read_config(workdir)
        # The folder that a stranger's config names is not made here.
        folder = data or Path(config.data.cache_dir)
        folder = folder if data or folder.is_dir() else workdir / "data"
        here = {"run": {"devices": 1}, "data": {"cache_dir": str(folder)}}
        self.config = replace_fields(config, here)
        self._predictors: dict[bool, Any] = {}  # by whether distances are known
        self._run: Any = None
        self._validation: DataSet | None = None
        prepare_process(1, 1)

    def find_step(self) -> int | None:
        """The step of the last whole checkpoint; None where there is none yet."""
        folder = self._workdir / "checkpoints"
        names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
        return max((int(name) for name in names if name.isdecimal()), default=None)

    def load(self):
        """Read the last checkpoint; ValueError where none can be read."""
        self._run = load_checkpoint(self.config, self._workdir)
        if not self._predictors:
            for is_known in (True, False):
                self._predictors[is_known] = make_predictor(
                    self._run.network, self.config, knows_distance=is_known
                )

    def show_validation(self) -> list[ShownObject]:
        """The first objects of the validation split, as the first views show them."""
        if self._validation is None:
            self._validation = _take_first(load_split(self._run, "val"))
        return self._show(self._validation)

    def show_images(self, paths: list[Path]) -> list[ShownObject]:
        """What images show, each an object; ValueError where none can be used."""
        spec = make_spec(self.config, None)
        found, _ = read_photographs(paths, spec, mask="auto")
        placed = [] if knows_distance(self.config, spec.crop) else found
        shown = self._show(make_dataset(found), placed)
        return [one._replace(name=show_text(Path(one.name).name)) for one in shown]

    def _show(
        self, dataset: DataSet, placed: Sequence[Photographs] = ()
    ) -> list[ShownObject]:
        """Objects as they are predicted; `placed` are those of unknown distance."""
        found = predict_all(self._predictors[not placed], self._run.state, dataset)
        if placed:
            dataset = make_dataset(place_photographs(placed, found.silhouettes[:, 0]))
        if found.cells is not None:
            from dpc_jax.learning.inference import volumes

            found = volumes.add_points(found, volumes.FIRST_THRESHOLD)
        models, views = arrange_views(dataset)
        shown = []
        for model, name in enumerate(dataset.names):
            places = list(zip(*np.nonzero(models == model), strict=True))
            points = align_points(self._run.alignment, found.points[places[0]])
            colors = None if found.colors is None else found.colors[places[0]]
            seen = tuple(
                self._show_view(found, place, dataset.images[model, views[place]])
                for place in places
            )
            shown.append(ShownObject(name, points, colors, views=seen))
        return shown

    def _show_view(self, found: Predictions, place, image) -> ShownView:
        alignment, candidates = self._run.alignment, None
        if not self.config.pose.known:
            candidates = Candidates(
                align_poses(alignment, found.candidates[place]),
                found.probabilities[place],
                found.losses[place],
            )
        return ShownView(
            align_poses(alignment, found.poses[place]),
            np.asarray(image),
            found.silhouettes[place],
            candidates,
        )


def _take_first(dataset: DataSet) -> DataSet:
    """Its first objects, with what predictions read of them in memory."""
    names = dataset.names[:_OBJECTS]
    taken = {
        name: Stack([dataset.rows(name, i) for i in range(len(names))])
        for name in ("images", "masks", "quaternions")
        if getattr(dataset, name) is not None
    }
    return dataset._replace(**taken, names=names)
