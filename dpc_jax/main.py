"""Train, evaluate and report: python -m dpc_jax.main --config=configs/car.py

Starting again in the same workdir goes on from its last checkpoint.
"""

import argparse
import functools
import sys
from collections.abc import Sequence
from pathlib import Path

from dpc_jax.config import Config, from_fields, locate_config
from dpc_jax.run.hosts import find_place
from dpc_jax.task import FlagParser, Task, run_command

_FIELDS = (
    "Every field of a config is a flag, as --config.train.steps=4000; "
    "dpc_jax/config/sections.py lists them with their units."
)


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command, but for the fields of the config."""
    parser = FlagParser(
        "train",
        description="Train, evaluate, report.",
        epilog=_FIELDS,
        allow_abbrev=False,
    )
    add = parser.add_argument
    text = "path of a config, or name of a shipped one: configs/car.py:paper, or car"
    add("--config", required=True, help=text)
    text = "folder of the run; runs/NAME-seedN where not given"
    add("--workdir", type=Path, metavar="DIR", help=text)
    text = "judge the finished run on objects by which nothing was chosen, instead"
    add("--final", action="store_true", help=text)
    text = "the same on the meshes of a folder of another source"
    add("--final_meshes", type=Path, metavar="DIR", help=text)
    text = "the same on test views as photographs show them"
    add("--photographs", action="store_true", help=text)
    text = "process 0, for a run of several processes"
    add("--coordinator", metavar="HOST:PORT", help=text)
    add("--processes", type=int, metavar="N", help="how many processes the run has")
    text = "which of them this one is, from 0"
    add("--process", type=int, metavar="I", help=text)
    return parser


def read_flags(arguments: Sequence[str]) -> tuple[argparse.Namespace, Config]:
    """The flags, and the config with its fields as they say.

    What is wrong with them is a ValueError of one sentence.
    """
    options, rest = make_parser().parse_known_args(arguments)
    # Libraries of the extra "learn": --help does without.
    from absl import flags
    from ml_collections import config_flags

    words = ["train", f"--config={locate_config(options.config)}", *rest]
    values = flags.FlagValues()
    config_flags.DEFINE_config_file("config", flag_values=values, sys_argv=words)
    try:
        others = values(words)[1:]
        # A config that could not be loaded says so only when it is read.
        config = from_fields(values.config.to_dict())
    except (flags.Error, AttributeError, KeyError, TypeError, ValueError, OSError) as e:
        raise ValueError(_explain(e)) from None
    if others:
        raise ValueError(
            f"Expected only flags, but {' '.join(others)} was given; write for example "
            "--config=configs/car.py."
        )
    return options, config


def _explain(error: Exception) -> str:
    """One line from what the flags library raises, which may hold a traceback."""
    while error.args and isinstance(error.args[0], Exception):
        error = error.args[0]
    text = str(error.args[0] if error.args else error).strip()
    last = text.splitlines()[-1].strip() if text else repr(error)
    if isinstance(error, KeyError):
        field, _, hint = text.partition("\n")
        return f"The config has no field {field}. {hint}".strip()
    if isinstance(error, OSError):
        return f"The config file could not be read: {last}; check the path."
    # A config file's own error comes with its traceback; its last line says it.
    return last.partition(": ")[2] if "Traceback" in text else last


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, train, evaluate, report; returns the exit status."""
    words = sys.argv[1:] if arguments is None else arguments
    status = run_command(lambda: _read(words))
    process = sys.modules.get("dpc_jax.run.process")  # where something has run
    return process.leave(status) if process else status


def _read(arguments: Sequence[str]) -> Task:
    options, config = read_flags(arguments)
    place = find_place(options.coordinator, options.processes, options.process)
    folder = options.workdir or _name_workdir(config, options.config)
    # Heavy: flags are read first.
    from dpc_jax.learning.training.records import NonFiniteError
    from dpc_jax.run import pipeline
    from dpc_jax.run.report.judging import judge_finally, judge_photographs

    work = functools.partial(pipeline.run, config, folder, place)
    if options.photographs:
        work = functools.partial(pipeline.judge, config, folder, judge_photographs)
    elif options.final or options.final_meshes:
        judge = functools.partial(judge_finally, meshes=options.final_meshes)
        work = functools.partial(pipeline.judge, config, folder, judge)
    return Task(
        work,
        out=folder,
        interrupted="Interrupted; start again in the same workdir to go on.",
        errors=(ValueError, OSError, NonFiniteError),
    )


def _name_workdir(config: Config, path: str) -> Path:
    """runs/car-paper-seed0, for instance."""
    variant = config.variant.replace(",", "-")
    parts = (Path(path.partition(":")[0]).stem, variant, f"seed{config.seed}")
    return Path("runs") / "-".join(part for part in parts if part)


if __name__ == "__main__":
    sys.exit(main())
