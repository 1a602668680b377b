"""One object without a network: python -m dpc_jax.fit FOLDER --out=DIR

FOLDER holds masked images of one object from several sides, with poses or without.
Writes cloud.ply, cloud.glb, fit.json, views.png and curve.png into DIR.
"""

import argparse
import sys
import types
from pathlib import Path

from dpc_jax.learning.fitting.object_fit import LEARNED, FitSettings, fit
from dpc_jax.run.flags import FlagParser, run_command
from dpc_jax.run.object_fitting import POSES, FitRequest, fit_folder

_DEFAULT = FitSettings()
_DEGREES = tuple(f"{angle:g}" for angle in _DEFAULT.elevations)


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command."""
    parser = FlagParser(
        prog="python -m dpc_jax.fit", description="One object without a network."
    )
    parser.add_argument(
        "folder",
        type=Path,
        help="of images with an alpha channel, or NAME_mask.png beside each",
    )
    parser.add_argument(
        "--out", type=Path, help="folder of the results (FOLDER's name-fit, here)"
    )
    parser.add_argument(
        "--poses",
        choices=POSES,
        default="auto",
        help="take those of the folder's pose file, begin with them, or find them; "
        "auto: take them where there are some",
    )
    parser.add_argument(
        "--crop",
        choices=("object", "view", "none"),
        default="object",
        help="frame all views at one scale, each at its own, or take them as they are",
    )
    parser.add_argument(
        "--learn",
        default="",
        help=f"of cameras, beside what poses say: {', '.join(LEARNED[1:])}",
    )
    parser.add_argument("--colors", action="store_true", help="learn colours too")
    parser.add_argument(
        "--points", type=int, default=_DEFAULT.num_points, help="(%(default)s)"
    )
    parser.add_argument(
        "--searches",
        type=int,
        default=_DEFAULT.searches,
        help="for poses, of which the best goes on (%(default)s)",
    )
    parser.add_argument(
        "--elevations",
        default=",".join(_DEGREES),
        help="lowest and highest of the cameras, for that (%(default)s degrees)",
    )
    parser.add_argument("--seed", type=int, default=0, help="(%(default)s)")
    return parser


def make_request(options: argparse.Namespace) -> FitRequest:
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
    try:
        request = make_request(make_parser().parse_args(arguments))
    except ValueError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    return run_command(
        lambda: fit_folder(request),
        out=request.out,
        interrupted="Interrupted; nothing was written, start again.",
    )


class _Callable(types.ModuleType):
    """`dpc_jax.fit` stays the function when this module has been imported, too."""

    def __call__(self, *args, **kwargs):
        return fit(*args, **kwargs)


sys.modules[__name__].__class__ = _Callable

if __name__ == "__main__":
    sys.exit(main())
