"""Image to point cloud and pose: python -m dpc_jax.predict --workdir=DIR IMAGE...

Uses the last checkpoint of a run. For every image it writes NAME.ply, NAME.glb and
NAME.json into --out, and one picture of all, predictions.png.
"""

import argparse
import sys
from pathlib import Path

from dpc_jax.run.flags import FlagParser, run_command


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser(
        "predict",
        takes="IMAGE... --workdir=DIR",
        description="Image to point cloud and pose.",
    )
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
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, predict, write; returns the exit status."""
    try:
        options = make_parser().parse_args(arguments)
    except ValueError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    from dpc_jax.run.prediction import predict_images  # heavy: flags are read first

    out = options.out or options.workdir / "predictions"
    return run_command(
        lambda: predict_images(
            options.images, workdir=options.workdir, out=out, crop=options.crop
        ),
        out=out,
        interrupted="Interrupted; start again to make the rest.",
    )


if __name__ == "__main__":
    sys.exit(main())
