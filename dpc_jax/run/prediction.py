"""Image to point cloud and pose, with the last checkpoint of a run."""

import json
import sys
from pathlib import Path

import numpy as np

from dpc_jax.config import replace_fields
from dpc_jax.data import DataSet, DataSpec
from dpc_jax.data.sets.image_folder import read_object
from dpc_jax.data.sets.pictures import FAULTS
from dpc_jax.evaluation import rotations
from dpc_jax.evaluation.alignment import (
    align_points,
    align_poses,
    identity_alignment,
)
from dpc_jax.files import write_text
from dpc_jax.learning.inference.predictor import (
    VIEWS_AT_ONCE,
    make_predictor,
    predict_all,
)
from dpc_jax.reporting.examples import Example
from dpc_jax.reporting.gallery import draw_predictions
from dpc_jax.reporting.page import write_files
from dpc_jax.run.finished import restore_state
from dpc_jax.run.setup import make_network
from dpc_jax.run.workdir import read_alignment, read_config

SHOWN = 16  # images in the picture


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
    # All devices of this machine share the views.
    shared = {"run": {"devices": 0}, "train": {"models_per_batch": VIEWS_AT_ONCE}}
    config = replace_fields(read_config(workdir), shared)
    names = [path.stem for path in images]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ValueError(
            f"Expected images of different names, but {', '.join(repeated)} came more "
            "than once; predict them one by one with an --out of their own."
        )
    state = restore_state(config, workdir)
    if crop is None:
        is_cut = config.data.images and config.data.crop != "none"
        crop = "view" if is_cut else "none"
    dataset = _read_images(images, config, crop=crop)
    predictor = make_predictor(make_network(config), config)
    predictions = predict_all(predictor, state, dataset)
    alignment = read_alignment(workdir)
    meshes = [None] * len(dataset.names)
    if predictions.cells is not None:
        # They need libraries of their own.
        from dpc_jax.learning.inference.volumes import add_points
        from dpc_jax.run import surfaces

        threshold = surfaces.read_threshold(workdir)
        predictions = add_points(predictions, threshold)
        frame = alignment or identity_alignment()
        meshes = [
            surfaces.find_surface(predictions, row, threshold, frame)
            for row in range(len(meshes))
        ]
    points, poses = predictions.points[:, 0], predictions.poses[:, 0]
    if alignment is not None:
        points, poses = align_points(alignment, points), align_poses(alignment, poses)
    out.mkdir(parents=True, exist_ok=True)
    examples = []
    for i, name in enumerate(dataset.names):
        example = Example(
            name=name,
            image=dataset.images[i, 0],
            target=dataset.masks[i, 0] / 255,
            predicted=predictions.silhouettes[i, 0],
            points=points[i],
            colors=None if predictions.colors is None else predictions.colors[i, 0],
            pose_error_deg=None,
            mesh=meshes[i],
        )
        pose = None if config.pose.known else poses[i]
        facts = _describe_pose(pose, is_aligned=alignment is not None)
        _write_prediction(out, example, facts | _describe_camera(predictions, i))
        examples.append(example)
    picture = draw_predictions(examples[:SHOWN], out / "predictions.png")
    for image, reason in dataset.skipped:
        print(f"Warning: {image} was left out: {reason}.", file=sys.stderr)
    if alignment is None:
        print(
            f"Warning: {workdir} has no report/alignment.json, so points and poses are "
            "in the network's own frame; finish the run first.",
            file=sys.stderr,
        )
    print(f"{len(dataset.names)} of {len(images)} images: {out}")
    print(f"Picture: {picture}")


def _write_prediction(out, example, facts):
    """NAME.ply, NAME.glb and NAME.json of one image."""
    write_files(example, out / example.name)
    write_text(out / f"{example.name}.json", json.dumps(facts, indent=2) + "\n")


def _read_images(paths: list[Path], config, *, crop: str) -> DataSet:
    """Every usable image as an object of one view, framed as in training."""
    spec = DataSpec(
        config.category,
        kind="images",
        folder=".",
        image_size=config.data.image_size,
        crop=crop,
        fill=config.data.fill,
        focal_length=config.render.focal_length,
        distance=config.render.distance,
    )
    images, masks, names, skipped = [], [], [], []
    for path in paths:
        try:
            if not path.is_file():
                raise ValueError(
                    f"Expected an image file, but there is no file {path}; check the "
                    "path."
                )
            arrays, _ = read_object(path, spec)
        except FAULTS as error:
            skipped.append((str(path), str(error).rstrip(".")))
            continue
        images.append(arrays["images"])
        masks.append(arrays["masks"])
        names.append(path.stem)
    if not names:
        first = skipped[0][1]
        if len(skipped) == 1:
            raise ValueError(f"{first}.")
        raise ValueError(
            "Expected at least one image that can be used, but none of "
            f"{len(skipped)} can; of the first: {first}."
        )
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
    azimuth, elevation = rotations.view_angles(quaternion)
    return {
        "frame": frame,
        "quaternion": rotations.canonical_sign(quaternion).tolist(),  # object to camera
        "azimuth_deg": azimuth,
        "elevation_deg": elevation,
    }


def _describe_camera(predictions, index) -> dict:
    """What NAME.json holds of the camera, where a run has learned it."""
    facts = {}
    if predictions.translations is not None:  # in the camera frame, box diagonals
        facts["translation"] = predictions.translations[index, 0].tolist()
    if predictions.focal_lengths is not None:  # of an image 1 wide
        facts["focal_length"] = float(predictions.focal_lengths[index, 0])
    return facts
