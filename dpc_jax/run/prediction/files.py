"""The files of predictions: clouds, figures of each object, pictures."""

from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.evaluation.confidence import describe
from dpc_jax.evaluation.rotations import describe_pose
from dpc_jax.files import write_json
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.export import write_files
from dpc_jax.reporting.gallery import draw_predictions
from dpc_jax.run.prediction.objects import PredictedObject

SHOWN = 16  # views in the picture


def write_predictions(
    predicted: list[PredictedObject], out: Path, *, surface: str
) -> tuple[list[dict], Path]:
    """Cloud, surface and NAME.json of each object, and one picture of the views.

    Returns:
      (an entry for each view, as in the JSON files and with its object's name; the
      picture).
    """
    entries, examples = [], []
    for one in predicted:
        name, views = one.photographs.name, _describe_views(one)
        shown = [_make_example(one, i) for i in range(len(views))]
        write_files(shown[0], out / name, surface=surface)
        facts: dict[str, Any] = {"frame": "object" if one.is_aligned else "network"}
        if one.seconds is not None:
            facts["refine_seconds"] = round(one.seconds, 2)
        facts |= views[0] if len(views) == 1 else {"views": views}
        write_json(out / f"{name}.json", facts)
        entries += [{"object": name, **view} for view in views]
        examples += shown
    picture = draw_predictions(examples[:SHOWN], out / "predictions.png")
    return entries, picture


def _describe_views(one: PredictedObject) -> list[dict[str, Any]]:
    """What is known of each view, with a sentence for people."""
    views = []
    for i, source in enumerate(one.photographs.sources):
        file, _, frame = source.partition(", frame ")
        name = Path(file).name + (f", frame {frame}" if frame else "")
        facts: dict[str, Any] = {"source": source, "quaternion": None}
        text = "its shape alone; this run was given poses, none is found."
        if one.poses is not None:
            facts |= describe_pose(one.poses[i])
            angles = facts["azimuth_deg"], facts["elevation_deg"]
            text = "seen from azimuth {:.0f}°, elevation {:.0f}°.".format(*angles)
        facts |= one.cameras[i]
        sentence = [f"{name}:", text]
        if one.confidences is not None:
            found = one.confidences[i]
            known = {n: round(v, 4) for n, v in found._asdict().items() if n != "error"}
            facts |= known | {"trust": found.level}
            sentence.append(describe(found))
        if one.errors is not None:
            before, after = map(float, one.errors[:, i])
            facts["silhouette_error"] = {"before": before, "after": after}
            text = f"Refined: silhouette error {before:.4f} to {after:.4f} per pixel."
            sentence.append(text)
        views.append(facts | {"sentence": " ".join(sentence)})
    return views


def _make_example(one: PredictedObject, view: int) -> Example:
    name, several = one.photographs.name, len(one.photographs.sources) > 1
    predicted = one.silhouettes[view]
    if one.poses is None:
        # Rendered from no pose of this view, so that a picture leaves it blank.
        predicted = np.full_like(predicted, np.nan)
    return Example(
        name=f"{name}, view {view + 1}" if several else name,
        image=one.photographs.images[view],
        target=one.photographs.masks[view] / 255,
        predicted=predicted,
        points=one.points,
        colors=one.colors,
        mesh=one.mesh,
    )
