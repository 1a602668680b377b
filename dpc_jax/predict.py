"""Images to point clouds and poses: python -m dpc_jax.predict --workdir=DIR IMAGE...

Uses the last checkpoint of a run. For every object it writes NAME.ply, NAME.glb and
NAME.json into --out, one picture of all, predictions.png, and predictions.json. Each
image is an object of its own; a folder or a moving picture (GIF, WebP) holds several
views of one object.
"""

import argparse
import sys
from pathlib import Path

from dpc_jax.files import SURFACES
from dpc_jax.task import FlagParser, Task, run_command


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command, with the names of `PredictRequest`."""
    parser = FlagParser(
        "predict",
        takes="IMAGE... --workdir=DIR",
        description="Images to point clouds and poses, with the network of a run.",
    )
    add = parser.add_argument
    add("--workdir", type=Path, required=True, help="of a trained run")
    add("--out", type=Path, help="folder (WORKDIR/predictions)")
    text = "files, moving pictures, folders of views"
    add("paths", nargs="+", type=Path, metavar="IMAGE", help=text)
    text = "alpha or NAME_mask.png; auto: plain ground (%(default)s)"
    add("--mask", choices=("given", "auto"), default="given", help=text)
    text = "an object in each image, or one in all (%(default)s)"
    add("--views", choices=("each", "one-object"), default="each", help=text)
    text = "fit shape and poses to the silhouettes"
    add("--refine", dest="is_refined", action="store_true", help=text)
    text = f"of surfaces: {', '.join(SURFACES)} (%(default)s)"
    add("--surface", choices=SURFACES, default="glb", metavar="AS", help=text)
    text = "of data, for --refine (WORKDIR/data)"
    add("--data", type=Path, metavar="DIR", help=text)
    text = "square around object or view (view; as trained on images)"
    add("--crop", choices=("object", "view", "none"), help=text)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, predict, write; returns the exit status."""
    return run_command(lambda: _read(make_parser().parse_args(arguments)))


def _read(options):
    # Flags are read before what is heavy is loaded.
    from dpc_jax.run.prediction import PredictRequest, predict_images

    options.out = options.out or options.workdir / "predictions"
    request = PredictRequest(**vars(options))
    return Task(
        lambda: predict_images(request),
        out=request.out,
        interrupted="Interrupted; start again to make the rest.",
    )


if __name__ == "__main__":
    sys.exit(main())
