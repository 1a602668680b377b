"""A folder of masked images of one object to its cloud and poses, without a network."""

import dataclasses
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from dpc_jax.data import DataSpec
from dpc_jax.data.sets.image_folder import read_views
from dpc_jax.data.sets.pose_files import QUATERNIONS, find_pose_files
from dpc_jax.evaluation.chamfer import find_rows
from dpc_jax.evaluation.rotations import describe_pose
from dpc_jax.evaluation.wrapping import wrap_points
from dpc_jax.files import write_json
from dpc_jax.learning.fitting import FitSettings
from dpc_jax.learning.fitting.object_fit import Fit, fit
from dpc_jax.outputs import show_text, telling_tenths
from dpc_jax.render import Camera
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.export import write_files
from dpc_jax.reporting.figures import draw_fit
from dpc_jax.reporting.gallery import draw_predictions
from dpc_jax.run.process import hasten_compilation, keep_compiled_programs

SHOWN = 8  # views in the picture, spread over all
GOOD_OVERLAP = 0.8  # below, a view is named
# As many were shown to be enough to find poses by; of six one was wrong at an overlap
# of 0.99 (docs/tutorial.md).
ENOUGH_VIEWS = 20


def fit_folder(
    folder: Path,
    out: Path,
    *,
    poses: str = "auto",
    crop: str = "object",
    image_size: int = 128,
    is_colored: bool = False,
    learn: tuple[str, ...] = (),
    settings: FitSettings = FitSettings(),
    surface: str = "glb",
    seed: int = 0,
):
    """Fit the object of a folder; write its cloud, surface, fit.json and pictures.

    Args:
      folder: of the images of one object.
      poses: of `POSES`; "auto" takes those of the folder's pose file as they are where
        it has one.
      crop: how images are framed, see `DataSpec`. A box about the mask has another
        middle than the object, so translations are learned, too, where images are cut
        out so; cameras of known place and lens need none.
      learn, settings, seed: see `fit`.

    Raises:
      ValueError: where no image can be used, or poses are asked for that are not there.
    """
    started = time.perf_counter()
    hasten_compilation()
    keep_compiled_programs()
    spec = DataSpec(
        "object", kind="images", folder=str(folder), image_size=image_size, crop=crop
    )
    names, arrays, rotations = _read_folder(folder, spec, poses)
    files = find_pose_files(folder)
    is_boxed = crop != "none" and all(path.name == QUATERNIONS for path in files)
    own = ("rotations",) * (poses == "rough") + ("translations",) * is_boxed
    learn = tuple(dict.fromkeys((*own, *learn)))
    found = fit(
        arrays["masks"],
        rotations=rotations,
        learn=learn,
        colors=arrays["images"] if is_colored else None,
        camera=Camera(spec.focal_length, spec.distance),
        settings=settings,
        seed=seed,
        on_progress=telling_tenths("Fitting"),
    )
    asked = {"poses": poses, "seed": seed, "settings": dataclasses.asdict(settings)}
    seconds = time.perf_counter() - started
    _write(out, found, arrays, names, asked, seconds, surface=surface)
    overlaps = dict(zip(names, found.overlaps, strict=True))
    for doubt in list_doubts(overlaps, is_searched=rotations is None):
        print(f"Warning: {doubt}.", file=sys.stderr)


def _read_folder(folder: Path, spec: DataSpec, poses: str):
    """(names of views, their arrays, rotations or None); warns of what is left out."""
    if not folder.is_dir():
        raise ValueError(
            f"Expected a folder with the images of one object, but {folder} is not a "
            "folder; put them into one."
        )
    paths, arrays, notes = read_views(folder, spec)
    for note in notes:
        print(f"Warning: a view is left out: {show_text(note)}.", file=sys.stderr)
    rotations = None if poses == "none" else arrays.get("quaternions")
    if poses in ("given", "rough") and rotations is None:
        raise ValueError(
            f"--poses={poses} needs the poses of {folder}, but it has neither "
            "poses.json nor transforms.json; add one (docs/data.md), or give "
            "--poses=none."
        )
    return [show_text(path.name) for path in paths], arrays, rotations


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


def _write(out: Path, found: Fit, arrays, names, asked, seconds, *, surface):
    out.mkdir(parents=True, exist_ok=True)
    count, mean = len(names), float(found.overlaps.mean())
    solid = wrap_points(found.points, is_fitted=True)
    examples = [
        Example(
            name=names[i],
            image=arrays["images"][i],
            target=arrays["masks"][i] / 255,
            predicted=found.silhouettes[i],
            points=found.points,
            colors=found.colors,
            mesh=solid,
        )
        for i in find_rows(count, min(SHOWN, count))
    ]
    mesh = write_files(examples[0], out / "cloud", surface=surface)
    picture = draw_predictions(examples, out / "views.png")
    draw_fit(found.curve, out / "curve.png")
    poses = zip(names, found.rotations, found.overlaps, strict=True)
    views = {n: describe_pose(q) | {"overlap": float(o)} for n, q, o in poses}
    if found.translations is not None:
        for name, moved in zip(names, found.translations.tolist(), strict=True):
            views[name]["translation"] = moved
    facts = {"overlap": mean, "seconds": seconds, "points": len(found.points)}
    facts |= {"sigma": found.sigma, "scale": found.scale, "side": found.side}
    facts |= asked | {"views": views, "curve": found.curve}
    write_json(out / "fit.json", facts)
    print(
        f"Overlap of silhouettes {mean:.3f} over {count} views, in {seconds:.0f} s: "
        f"{show_text(mesh)}, {show_text(picture)}"
    )
