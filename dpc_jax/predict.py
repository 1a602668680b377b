"""Image to point cloud and pose: python -m dpc_jax.predict --workdir=DIR IMAGE...

Uses the last checkpoint of a run. For every image it writes NAME.ply, NAME.glb and
NAME.json into --out, and one picture of all, predictions.png.
"""

import argparse
import json
import math
import os
import sys
from pathlib import Path

import ml_collections
import numpy as np

from dpc_jax.data import DataSet
from dpc_jax.data.sets.image_folder import read_object
from dpc_jax.data.sets.pictures import FAULTS
from dpc_jax.evaluation import rotations
from dpc_jax.evaluation.alignment import align_points, align_poses
from dpc_jax.files import write_text
from dpc_jax.learning import evaluator
from dpc_jax.learning.checkpoints import Checkpoints
from dpc_jax.learning.step import init_state
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.export import write_glb, write_ply
from dpc_jax.reporting.gallery import draw_predictions
from dpc_jax.run import configuration
from dpc_jax.run.process import keep_freed_memory
from dpc_jax.run.workdir import read_alignment, read_config

SHOWN = 16  # images in the picture


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, predict, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workdir", type=Path, required=True, help="of a trained run")
    parser.add_argument("--out", type=Path, help="folder; WORKDIR/predictions if none")
    parser.add_argument(
        "images",
        nargs="+",
        type=Path,
        metavar="IMAGE",
        help="with an alpha channel, or NAME_mask.png beside it",
    )
    parser.add_argument(
        "--crop",
        choices=("view", "none"),
        help="cut a square around the object, or take the image as it is framed; as "
        "in training where none",
    )
    options = parser.parse_args(arguments)
    try:
        predict_images(
            options.images,
            workdir=options.workdir,
            out=options.out or options.workdir / "predictions",
            crop=options.crop,
        )
    except (ValueError, OSError) as error:
        if os.environ.get("DPC_JAX_TRACEBACK"):
            raise
        print(f"Error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("Interrupted; start again to make the rest.", file=sys.stderr)
        return 130
    return 0


def predict_images(
    images: list[Path], *, workdir: Path, out: Path, crop: str | None = None
):
    """Predict shape and pose of every image that can be read, and write the files.

    Args:
      images: files with an alpha channel, or a mask beside them.
      workdir: of the run. out: folder of the results.
      crop: "view" cuts a square in which the object takes the config's `data.fill`,
        "none" keeps the image's own framing; None is as in training. A network that
        was trained on renders expects their framing: a distance of two box diagonals.

    Raises:
      ValueError: where the workdir holds no run, its checkpoints cannot be read, no
        image can be used, or two images would write the same files.
      OSError: where files cannot be read or written.
    """
    config = read_config(workdir)
    names = [path.stem for path in images]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ValueError(
            f"Expected images of different names, got {', '.join(repeated)} more than "
            "once; predict them one by one with an --out of their own."
        )
    predictor, state = _load_model(config, workdir)
    if crop is None:
        is_cut = config.data.images and config.data.crop != "none"
        crop = "view" if is_cut else "none"
    dataset = _read_images(images, config, crop=crop)
    predictions = evaluator.predict_all(predictor, state, dataset)
    alignment = read_alignment(workdir)
    points, poses = predictions.points[:, 0], predictions.poses[:, 0]
    if alignment is not None:
        points, poses = align_points(alignment, points), align_poses(alignment, poses)
    out.mkdir(parents=True, exist_ok=True)
    examples = []
    for i, name in enumerate(dataset.names):
        colors = None if predictions.colors is None else predictions.colors[i, 0]
        write_ply(out / f"{name}.ply", points[i], colors)
        write_glb(out / f"{name}.glb", points[i], colors)
        facts = _describe_pose(
            None if config.pose.known else poses[i], is_aligned=alignment is not None
        )
        write_text(out / f"{name}.json", json.dumps(facts, indent=2) + "\n")
        examples.append(
            Example(
                name=name,
                image=dataset.images[i, 0],
                target=dataset.masks[i, 0] / 255,
                predicted=predictions.silhouettes[i, 0],
                points=points[i],
                colors=colors,
                pose_error_deg=None,
            )
        )
    picture = draw_predictions(examples[:SHOWN], out / "predictions.png")
    for image, reason in dataset.skipped:
        print(f"Warning: {image} was left out: {reason}.", file=sys.stderr)
    if alignment is None:
        print(
            f"Warning: {workdir} has no report/alignment.json, so points and poses are "
            "in the frame that the network made up; finish the run first.",
            file=sys.stderr,
        )
    print(f"{len(dataset.names)} of {len(images)} images: {out}")
    print(f"Picture: {picture}")


def _load_model(config: ml_collections.ConfigDict, workdir: Path):
    """Compiled predictor and the last state of a run."""
    keep_freed_memory()
    settings = configuration.make_settings(config)
    network = configuration.make_network(config)
    state = init_state(network, settings, image_size=config.data.image_size)
    folder = workdir / "checkpoints"
    restored = None
    if folder.is_dir():
        checkpoints = Checkpoints(folder)
        restored = checkpoints.restore(state)
        checkpoints.close()
    if restored is None:
        raise ValueError(
            f"Expected a checkpoint in {folder}, found none; train with "
            f"python -m dpc_jax.main --workdir={workdir} first."
        )
    return evaluator.make_predictor(network, settings), restored.state


def _read_images(paths: list[Path], config, *, crop: str) -> DataSet:
    """Every usable image as an object of one view, framed as in training."""
    images, masks, names, skipped = [], [], [], []
    for path in paths:
        try:
            if not path.is_file():
                raise ValueError(f"expected an image file, {path} is none")
            arrays, _ = read_object(
                path,
                image_size=config.data.image_size,
                crop=crop,
                fill=config.data.fill,
                focal_length=config.render.focal_length,
                distance=config.render.distance,
            )
        except FAULTS as error:
            skipped.append((str(path), str(error).rstrip(".")))
            continue
        images.append(arrays["images"])
        masks.append(arrays["masks"])
        names.append(path.stem)
    if not names:
        raise ValueError(f"No image could be used; {skipped[0][1]}.")
    return DataSet(
        images=np.stack(images),
        masks=np.stack(masks),
        depths=None,
        quaternions=None,
        surfaces=None,
        names=tuple(names),
        skipped=tuple(skipped),
    )


def _describe_pose(quaternion, *, is_aligned: bool) -> dict:
    """What NAME.json holds; a run on known poses predicts none."""
    frame = "object" if is_aligned else "network"
    if quaternion is None:
        return {"frame": frame, "quaternion": None}
    # The camera's place as seen from the object: the axis of view, turned back.
    w, x, y, z = (float(v) for v in rotations.canonical_sign(quaternion))
    towards = -np.array(
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    )
    return {
        "frame": frame,
        "quaternion": [w, x, y, z],  # wxyz, object to camera
        "azimuth_deg": math.degrees(math.atan2(towards[1], towards[0])) % 360,
        "elevation_deg": math.degrees(math.asin(float(np.clip(towards[2], -1, 1)))),
    }


if __name__ == "__main__":
    sys.exit(main())
