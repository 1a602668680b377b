"""A folder of masked images of one object to its cloud and poses, without a network."""

import dataclasses
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dpc_jax.data import DataSpec
from dpc_jax.data.sets.image_folder import read_views
from dpc_jax.evaluation.rotations import canonical_sign, view_angles
from dpc_jax.files import write_json
from dpc_jax.learning.fitting.object_fit import Fit, fit
from dpc_jax.learning.fitting.settings import FitSettings
from dpc_jax.learning.training.progress import CountReport
from dpc_jax.outputs import show_text
from dpc_jax.render import Camera
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.figures import draw_fit
from dpc_jax.reporting.gallery import draw_predictions
from dpc_jax.reporting.page import write_files
from dpc_jax.run.process import keep_compiled_programs

SHOWN = 8  # views in the picture, spread over all
GOOD_OVERLAP = 0.8  # below, a view is named
# As many were shown to be enough to find poses by; of six half were wrong at an overlap
# of 0.94 (docs/fitting.md, docs/tutorial.md).
ENOUGH_VIEWS = 20


@dataclasses.dataclass(frozen=True)
class FitRequest:
    """What a fit is asked for.

    Attributes:
      folder: of the images of one object. out: folder of the results.
      poses: of `POSES`; "auto" takes those of the folder's pose file as they are where
        it has one.
      crop: how images are framed, see `DataSpec`.
      image_size: pixels that images are brought to.
      is_colored: whether points learn colours.
      learn: see `fit`. settings: of the fit. seed: of its random numbers.
    """

    folder: Path
    out: Path
    poses: str = "auto"
    crop: str = "object"
    image_size: int = 128
    is_colored: bool = False
    learn: tuple[str, ...] = ()
    settings: FitSettings = FitSettings()
    seed: int = 0


def fit_folder(request: FitRequest) -> Fit:
    """Fit the object of a folder and write cloud.ply, cloud.glb, fit.json and pictures.

    Raises:
      ValueError: where no image can be used, or poses are asked for that are not there.
      OSError: where files cannot be read or written.
    """
    started = time.perf_counter()
    keep_compiled_programs()
    spec = DataSpec(
        "object",
        kind="images",
        folder=str(request.folder),
        image_size=request.image_size,
        crop=request.crop,
    )
    if not request.folder.is_dir():
        raise ValueError(
            f"Expected a folder with the images of one object, but {request.folder} is "
            "not a folder; put them into one."
        )
    paths, arrays, notes = read_views(request.folder, spec)
    for note in notes:
        print(f"Warning: a view is left out: {show_text(note)}.", file=sys.stderr)
    rotations, learn = _choose_poses(request, arrays.get("quaternions"))
    images = arrays["images"]
    with CountReport("Fitting") as progress:
        found = fit(
            arrays["masks"],
            rotations=rotations,
            learn=learn,
            colors=images if request.is_colored else None,
            camera=Camera(spec.focal_length, spec.distance),
            settings=request.settings,
            seed=request.seed,
            on_progress=progress.report,
        )
    names = [show_text(path.name) for path in paths]
    _write(request, found, arrays, names, time.perf_counter() - started)
    overlaps = dict(zip(names, found.overlaps, strict=True))
    for doubt in list_doubts(overlaps, is_searched=rotations is None):
        print(f"Warning: {doubt}.", file=sys.stderr)
    return found


def list_doubts(overlaps: Mapping[str, float], *, is_searched: bool) -> list[str]:
    """Why not to trust a fit, each reason in a sentence.

    Args:
      overlaps: of predicted and given silhouettes, by view.
      is_searched: whether poses were found by the fit.
    """
    doubts, count = [], len(overlaps)
    poor = [name for name, overlap in overlaps.items() if overlap < GOOD_OVERLAP]
    if poor:
        doubts.append(
            f"the shape does not explain {len(poor)} of {count} views well: "
            f"{', '.join(poor[:5])}; look at them in views.png, and at their masks"
        )
    if is_searched and count < ENOUGH_VIEWS:
        doubts.append(
            f"{count} views are few to find poses by, and a wrong shape may explain "
            f"them; give {ENOUGH_VIEWS} or more, or their poses"
        )
    return doubts


def _choose_poses(request, given):
    """The rotations to begin with, and what of the cameras is learned."""
    if request.poses in ("given", "rough") and given is None:
        raise ValueError(
            f"--poses={request.poses} needs the poses of {request.folder}, but it has "
            "neither poses.json nor transforms.json; add one (docs/data.md), or give "
            "--poses=none."
        )
    if request.poses == "none":
        given = None
    learn = request.learn
    if request.poses == "rough":
        learn = tuple(dict.fromkeys(("rotations", *learn)))
    return given, learn


def _write(request: FitRequest, found: Fit, arrays, names, seconds):
    out = request.out
    out.mkdir(parents=True, exist_ok=True)
    count = len(found.overlaps)
    chosen = np.unique(np.linspace(0, count - 1, min(SHOWN, count)).round().astype(int))
    examples = [
        Example(
            name=names[i],
            image=arrays["images"][i],
            target=arrays["masks"][i] / 255,
            predicted=found.silhouettes[i],
            points=found.points,
            colors=found.colors,
            pose_error_deg=None,
        )
        for i in chosen
    ]
    write_files(examples[0], out / "cloud")
    picture = draw_predictions(examples, out / "views.png")
    draw_fit(found.curve, out / "curve.png")
    views = {}
    for i, name in enumerate(names):
        azimuth, elevation = view_angles(found.rotations[i])
        views[name] = {
            "quaternion": canonical_sign(found.rotations[i]).tolist(),
            "azimuth_deg": azimuth,
            "elevation_deg": elevation,
            "overlap": float(found.overlaps[i]),
        }
    mean = float(found.overlaps.mean())
    write_json(
        out / "fit.json",
        {
            "overlap": mean,
            "seconds": seconds,
            "points": len(found.points),
            "sigma": found.sigma,
            "scale": found.scale,
            "side": found.side,
            "poses": request.poses,
            "seed": request.seed,
            "settings": dataclasses.asdict(request.settings),
            "views": views,
            "curve": found.curve,
        },
    )
    print(
        f"Overlap of silhouettes {mean:.3f} over {count} views, in {seconds:.0f} s: "
        f"{show_text(out / 'cloud.glb')}, {show_text(picture)}"
    )
