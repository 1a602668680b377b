"""One object without a network: python -m dpc_jax.fit FOLDER --out=DIR

FOLDER holds masked images of one object from several sides, with poses or without.
Writes cloud.ply, cloud.glb, fit.json, views.png and curve.png into DIR.
"""

import argparse
import sys
import types
from pathlib import Path
from typing import TYPE_CHECKING

from dpc_jax.learning.fitting.settings import LEARNED, POSES, FitSettings
from dpc_jax.run.flags import FlagParser, Task, run_command

if TYPE_CHECKING:
    from dpc_jax.run.object_fitting import FitRequest

_DEFAULT = FitSettings()
_DEGREES = tuple(f"{angle:g}" for angle in _DEFAULT.elevations)


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser(
        "fit", takes="FOLDER", description="One object without a network."
    )
    parser.add_argument(
        "folder",
        type=Path,
        metavar="FOLDER",
        help="of images with alpha channel, or NAME_mask.png beside",
    )
    parser.add_argument("--out", type=Path, help="folder of the results (./FOLDER-fit)")
    parser.add_argument(
        "--poses",
        choices=POSES,
        default="auto",
        metavar="HOW",
        help="given: take the folder's poses; rough: begin with them; none: find them; "
        "auto: given where there are some",
    )
    parser.add_argument(
        "--crop",
        choices=("object", "view", "none"),
        default="object",
        metavar="HOW",
        help="object: one scale for all views; view: one for each; none: as they are",
    )
    parser.add_argument(
        "--learn",
        default="",
        metavar="WHAT",
        help=f"of cameras: {', '.join(LEARNED[1:])}",
    )
    parser.add_argument("--colors", action="store_true", help="learn colours too")
    parser.add_argument(
        "--points",
        type=int,
        metavar="N",
        default=_DEFAULT.num_points,
        help="of the cloud (%(default)s)",
    )
    parser.add_argument(
        "--searches",
        type=int,
        default=_DEFAULT.searches,
        metavar="N",
        help="for poses; the best goes on (%(default)s)",
    )
    parser.add_argument(
        "--elevations",
        default=",".join(_DEGREES),
        metavar="A,B",
        help="lowest and highest of cameras (%(default)s degrees)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="(%(default)s)"
    )
    return parser


def make_request(options: argparse.Namespace) -> "FitRequest":
    """What the flags ask for.

    Raises:
      ValueError: for numbers out of range.
    """
    for name in ("points", "searches"):
        if getattr(options, name) < 1:
            raise ValueError(
                f"--{name} must be at least 1, but it is {getattr(options, name)}; "
                "leave it out for the default."
            )
    try:
        low, high = map(float, options.elevations.split(","))
    except ValueError:
        low, high = 1.0, 0.0
    if not -90 < low < high < 90:
        raise ValueError(
            "--elevations must be two numbers between -90 and 90, the lower one first, "
            f"but it is {options.elevations}; write for example --elevations=-10,60."
        )
    learn = tuple(word for word in options.learn.split(",") if word)
    if unknown := [name for name in learn if name not in LEARNED]:
        raise ValueError(
            f"--learn must be of {', '.join(LEARNED)}, but it has {unknown[0]}; write "
            "for example --learn=translations."
        )
    from dpc_jax.run.object_fitting import FitRequest  # heavy: flags are read first

    out = options.out or Path(f"{options.folder.resolve().name}-fit")
    return FitRequest(
        options.folder,
        out,
        poses=options.poses,
        crop=options.crop,
        is_colored=options.colors,
        learn=learn,
        settings=FitSettings(
            num_points=options.points,
            searches=options.searches,
            elevations=(low, high),
        ),
        seed=options.seed,
    )


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, fit, write; returns the exit status."""
    return run_command(lambda: _read(make_parser().parse_args(arguments)))


def _read(options):
    request = make_request(options)
    # Heavy: flags are read first.
    from dpc_jax.data.sets.image_folder import list_images
    from dpc_jax.run.object_fitting import fit_folder

    def work():
        fit_folder(request)

    return Task(
        work,
        out=request.out,
        interrupted="Interrupted; nothing was written, start again.",
        writes=("cloud.ply", "cloud.glb", "views.png", "curve.png", "fit.json"),
        inputs=list_images(request.folder) if request.folder.is_dir() else (),
    )


class _Callable(types.ModuleType):
    """`dpc_jax.fit` stays the function when this module has been imported, too."""

    def __call__(self, *args, **kwargs):
        from dpc_jax.learning.fitting.object_fit import fit  # heavy, as above

        return fit(*args, **kwargs)


sys.modules[__name__].__class__ = _Callable

if __name__ == "__main__":
    sys.exit(main())
