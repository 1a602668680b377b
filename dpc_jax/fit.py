"""One object without a network: python -m dpc_jax.fit FOLDER --out=DIR

FOLDER holds masked images of one object from several sides, with poses or without.
Writes cloud.ply, its surface cloud.glb, fit.json, views.png and curve.png into DIR.
"""

import argparse
import functools
import sys
import types
from pathlib import Path

from dpc_jax.files import SURFACES
from dpc_jax.learning.fitting import LEARNED, POSES, FitSettings
from dpc_jax.task import FlagParser, Task, read_count, reading_names, run_command

_DEFAULT = FitSettings()


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command, with the names of `fit_folder` and `FitSettings`."""
    parser = FlagParser(
        "fit", takes="FOLDER", description="One object without a network."
    )
    add = parser.add_argument
    text = "of images with alpha channel, or NAME_mask.png beside"
    add("folder", type=Path, metavar="FOLDER", help=text)
    add("--out", type=Path, help="folder of the results (./FOLDER-fit)")
    text = (
        "given: take the folder's poses; rough: search near them; none: find them; "
        "auto: given where there are some"
    )
    add("--poses", choices=POSES, default="auto", metavar="HOW", help=text)
    text = "object: one scale for all views; view: one for each; none: as they are"
    crops = ("object", "view", "none")
    add("--crop", choices=crops, default="object", metavar="HOW", help=text)
    text = f"of cameras: {', '.join(LEARNED[1:])}"
    reading = reading_names(LEARNED)
    add("--learn", type=reading, default=(), metavar="WHAT", help=text)
    text = "learn colours too"
    add("--colors", dest="is_colored", action="store_true", help=text)
    count = {"type": read_count, "metavar": "N"}
    text = "of the cloud (%(default)s)"
    default = _DEFAULT.num_points
    add("--points", dest="num_points", default=default, help=text, **count)
    text = f"of its surface: {', '.join(SURFACES)} (%(default)s)"
    add("--surface", choices=SURFACES, default="glb", metavar="AS", help=text)
    text = "pixels of images (%(default)s); more show thin parts"
    sizes = (64, 128, 256, 512)
    add("--image-size", choices=sizes, default=128, help=text, **count)
    text = "for poses; the best goes on (%(default)s)"
    add("--searches", default=_DEFAULT.searches, help=text, **count)
    text = "lowest and highest of cameras (-20,40 degrees)"
    angles = {"type": _read_elevations, "default": _DEFAULT.elevations}
    add("--elevations", metavar="A,B", help=text, **angles)
    add("--seed", type=int, default=0, metavar="N", help="(%(default)s)")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, fit, write; returns the exit status."""
    return run_command(lambda: _read(make_parser().parse_args(arguments)))


def _read(options):
    # Heavy: flags are read first.
    from dpc_jax.data.sets.image_folder import list_images
    from dpc_jax.run.object_fitting import fit_folder

    given = vars(options)
    folder = given.pop("folder")
    out = given.pop("out") or Path(f"{folder.resolve().name}-fit")
    fields = ("num_points", "searches", "elevations")
    settings = FitSettings(**{name: given.pop(name) for name in fields})
    work = functools.partial(fit_folder, folder, out, settings=settings, **given)
    names = "cloud.ply", f"cloud{SURFACES[given['surface']]}", "views.png", "curve.png"
    return Task(
        work,
        out=out,
        interrupted="Interrupted; nothing was written, start again.",
        writes=(*names, "fit.json"),
        inputs=list_images(folder) if folder.is_dir() else (),
    )


def _read_elevations(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(","))
    except ValueError:
        low, high = 1.0, 0.0
    if not -90 < low < high < 90:
        raise argparse.ArgumentTypeError(
            "it must be two numbers between -90 and 90, the lower one first, as in "
            f"-10,60, not {text!r}"
        )
    return low, high


class _Callable(types.ModuleType):
    """`dpc_jax.fit` stays the function when this module has been imported, too."""

    def __call__(self, *args, **kwargs):
        from dpc_jax.learning.fitting.object_fit import fit  # heavy, as above

        return fit(*args, **kwargs)


sys.modules[__name__].__class__ = _Callable

if __name__ == "__main__":
    sys.exit(main())
