"""Images to point clouds and poses: python -m dpc_jax.predict --workdir=DIR IMAGE...

Uses the last checkpoint of a run. For every object it writes NAME.ply, NAME.glb and
NAME.json into --out, one picture of all, predictions.png, and predictions.json. Each
image is an object of its own; a folder or a moving picture (GIF, WebP) holds several
views of one object.
"""

import argparse
import sys
from pathlib import Path

from dpc_jax.run.flags import FlagParser, Task, run_command

MASKS = ("given", "auto", "matting")  # of data.sets.photographs, which --help loads not


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser(
        "predict",
        takes="IMAGE... --workdir=DIR",
        description="Images to point clouds and poses, with the network of a run.",
    )
    parser.add_argument("--workdir", type=Path, required=True, help="of a trained run")
    parser.add_argument("--out", type=Path, help="folder (WORKDIR/predictions)")
    parser.add_argument(
        "images",
        nargs="+",
        type=Path,
        metavar="IMAGE",
        help="files, moving pictures, folders of views",
    )
    parser.add_argument(
        "--mask",
        choices=MASKS,
        default="given",
        help="alpha or NAME_mask.png; auto: of a plain background (%(default)s)",
    )
    parser.add_argument(
        "--views",
        choices=("each", "one-object"),
        default="each",
        help="an object in each image, or one in all (%(default)s)",
    )
    parser.add_argument(
        "--refine", action="store_true", help="fit shape and poses to the silhouettes"
    )
    parser.add_argument(
        "--points",
        type=int,
        default=0,
        metavar="N",
        help="of clouds, more than are predicted, by midpoints",
    )
    parser.add_argument(
        "--turntable", action="store_true", help="write NAME.gif of the cloud turning"
    )
    parser.add_argument(
        "--data",
        type=Path,
        metavar="DIR",
        help="of data, for --refine (WORKDIR/data)",
    )
    parser.add_argument(
        "--crop",
        choices=("object", "view", "none"),
        help="square around object or view (as trained)",
    )
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, predict, write; returns the exit status."""
    return run_command(lambda: _read(make_parser().parse_args(arguments)))


def _read(options):
    # Flags are read before what is heavy is loaded.
    from dpc_jax.run.prediction import SUMMARIES, PredictRequest, predict_images

    request = PredictRequest(
        options.images,
        workdir=options.workdir,
        out=options.out or options.workdir / "predictions",
        crop=options.crop,
        mask=options.mask,
        is_one_object=options.views == "one-object",
        is_refined=options.refine,
        has_turntable=options.turntable,
        num_points=options.points,
        data=options.data,
    )
    return Task(
        lambda: predict_images(request),
        out=request.out,
        interrupted="Interrupted; start again to make the rest.",
        writes=SUMMARIES,
    )


if __name__ == "__main__":
    sys.exit(main())
