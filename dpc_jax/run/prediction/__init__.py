"""Images to point clouds and poses: what is asked for, and the order of work.

This module loads no JAX: what is wrong with the files is said before that.
"""

import dataclasses
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from dpc_jax.config import Config
from dpc_jax.data.sets import photographs
from dpc_jax.data.sets.photographs import Photographs
from dpc_jax.data.spec import DataSpec
from dpc_jax.files import SURFACES, write_json
from dpc_jax.outputs import owning, show_text
from dpc_jax.run.workdir import read_config

SENTENCES = 20  # that are printed; predictions.json has all


@dataclasses.dataclass(frozen=True)
class PredictRequest:
    """What predictions are asked for; the flags of the command by their names here."""

    # Image files, moving pictures, folders of views of an object or of such folders.
    paths: Sequence[Path]
    workdir: Path  # of the run
    out: Path  # folder of the results
    # "view" cuts a square in which the object takes `DataSpec.fill`, "object" at the
    # scale that the largest of its views needs, "none" keeps the image's own framing,
    # which is that of training then. None is as in training on images, and "view" for a
    # network that was trained on renders.
    crop: str | None = None
    mask: str = "given"  # or "auto", see `read_photographs`
    views: str = "each"  # image shows an object, or all of them "one-object"
    is_refined: bool = False  # whether shape and poses are fitted to the silhouettes
    surface: str = "glb"  # of `SURFACES`
    data: Path | None = None  # of rendered data sets; None for the workdir's own


def predict_images(request: PredictRequest):
    """Predict shape and pose of every object that can be read, and write the files."""
    started = time.perf_counter()
    config = read_config(request.workdir)
    if request.is_refined:
        check_ability(config, "--refine")
    found, skipped = photographs.read_photographs(
        request.paths,
        make_spec(config, request.crop),
        mask=request.mask,
        is_one_object=request.views == "one-object",
    )
    for source, reason in skipped:
        print(f"Warning: {source} was left out: {reason}.", file=sys.stderr)
    if any(len(one.sources) > 1 for one in found):
        check_ability(config, "Several views of an object together")
    ends = [".ply", SURFACES[request.surface], ".json"]
    names = [f"{one.name}{end}" for one in found for end in ends]
    names += ["predictions.png", "predictions.json"]  # of all images
    inputs = [file for one in found for file in one.files]
    with owning(request.out, names, inputs=inputs):
        _warn_of_frame(request.workdir)
        _predict(request, found, skipped, started)


def _predict(request: PredictRequest, found: list[Photographs], skipped, started):
    # These load JAX, which takes seconds.
    from dpc_jax.run.prediction.files import write_predictions
    from dpc_jax.run.prediction.objects import predict_objects

    predicted = predict_objects(found, request)
    entries, picture = write_predictions(
        predicted, request.out, surface=request.surface
    )
    # Refinement is timed on its own; all else is in here too.
    seconds = time.perf_counter() - started
    content = {
        "workdir": show_text(request.workdir),
        "refined": request.is_refined,
        "seconds": round(seconds, 2),
        "images": entries,
        "left_out": [{"source": s, "reason": f"{reason}."} for s, reason in skipped],
    }
    write_json(request.out / "predictions.json", content)
    for entry in entries[:SENTENCES]:
        print(entry["sentence"])
    if len(entries) > SENTENCES:
        print(f"... and {len(entries) - SENTENCES} more.")
    total = len(entries) + len(skipped)
    print(
        f"{len(entries)} of {total} images in {seconds:.0f} s: "
        f"{show_text(request.out)} (predictions.json has all figures)"
    )
    print(f"Picture: {show_text(picture)}")


def make_spec(config: Config, crop: str | None) -> DataSpec:
    """How images are framed for a run; see `PredictRequest.crop`."""
    if crop is None:
        crop = config.data.crop if config.data.images else "view"
    return DataSpec(
        config.category,
        kind="images",
        folder=".",
        image_size=config.data.image_size,
        crop=crop,
        focal_length=config.render.focal_length,
        distance=config.render.distance,
    )


def knows_distance(config: Config, crop: str) -> bool:
    """Whether images that are framed so look as those that a run learned from."""
    return crop == "none" or bool(config.data.images and crop == config.data.crop)


def check_ability(config: Config, what: str):
    """Refuse what needs codes of points, and poses, of a run that has none."""
    lacking = "was given its poses" if config.pose.known else ""
    if config.network.shape != "points":
        lacking = f"predicts {config.network.shape}"
    if lacking:
        raise ValueError(
            f"{what} needs a run that learns point clouds and poses, but this one "
            f"{lacking}; use another run, or predict image by image without it."
        )


def _warn_of_frame(workdir: Path):
    report, name = workdir / "report", show_text(workdir)
    text = (
        f"Warning: {name} has no report/alignment.json, so points and poses are in "
        "the network's own frame; finish the run first."
    )
    if (report / "metrics.json").is_file():
        text = (
            f"Note: {name} was trained on images without poses, so points and poses "
            "are in the frame that its network found: it may be turned or mirrored."
        )
    if not (report / "alignment.json").is_file():
        print(text, file=sys.stderr)
