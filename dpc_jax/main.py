"""Train, evaluate and report: python -m dpc_jax.main --config=configs/car.py

Starting again in the same workdir goes on from its last checkpoint.
"""

import argparse
import functools
import sys
from pathlib import Path
from typing import Any

from absl import app, flags, logging

from dpc_jax.config import from_config_dict, resolve_flags
from dpc_jax.run.hosts.places import Place, find_place
from dpc_jax.task import FlagParser, hush_jaxlib, say_missing

try:
    from ml_collections import config_flags
except ModuleNotFoundError as error:
    sys.exit(say_missing(error))

_CONFIG = config_flags.DEFINE_config_file(
    "config",
    None,
    "Path of a config, or name of a shipped one: configs/car.py:paper, or car.",
)
_WORKDIR = flags.DEFINE_string(
    "workdir", None, "Folder of the run; runs/NAME-seedN where not given."
)
_FINAL = flags.DEFINE_bool(
    "final",
    False,
    "Judge the finished run on objects by which nothing was chosen, instead.",
)
_FINAL_MESHES = flags.DEFINE_string(
    "final_meshes", None, "The same on the meshes of a folder of another source."
)
_PHOTOGRAPHS = flags.DEFINE_bool(
    "photographs",
    False,
    "The same on test views as photographs show them.",
)
_COORDINATOR = flags.DEFINE_string(
    "coordinator", None, "HOST:PORT of process 0, for a run of several processes."
)
_PROCESSES = flags.DEFINE_integer("processes", None, "How many processes the run has.")
_PROCESS = flags.DEFINE_integer("process", None, "Which of them this one is, from 0.")
_VALUES = {  # of the flags, for --help
    "config": "CONFIG",
    "workdir": "DIR",
    "final": None,
    "final_meshes": "DIR",
    "photographs": None,
    "coordinator": "HOST:PORT",
    "processes": "N",
    "process": "I",
}
_FIELDS = (
    "Every field of a config is a flag, as --config.train.steps=4000; "
    "dpc_jax/config/sections.py lists them with their units."
)


def make_parser() -> argparse.ArgumentParser:
    """The flags of the command, for --help."""
    parser = FlagParser("train", description="Train, evaluate, report.", epilog=_FIELDS)
    for name, value in _VALUES.items():
        kind: Any = {"metavar": value} if value else {"action": "store_true"}
        parser.add_argument(f"--{name}", help=flags.FLAGS[name].help, **kind)
    return parser


def _parse(argv):
    """Parse the flags; what is wrong with them is said in one sentence."""
    if {"--help", "-h"} & set(argv[1:]):
        make_parser().print_help()
        sys.exit(0)
    try:
        rest = flags.FLAGS(resolve_flags(argv))
        if len(rest) > 1:
            raise ValueError(
                f"Expected only flags, but {' '.join(rest[1:])} was given; write "
                "for example --config=configs/car.py."
            )
        if _CONFIG.value is None:
            raise ValueError(
                "Expected a config, but none was given; write for example "
                "--config=configs/car.py."
            )
        # A config that could not be loaded says so only when it is read.
        from_config_dict(_CONFIG.value)
        _find_place()
        return rest
    except (flags.Error, AttributeError, KeyError, TypeError, ValueError, OSError) as e:
        print(f"Error: {_explain(e)}", file=sys.stderr)
        sys.exit(2)


def _find_place() -> Place | None:
    return find_place(_COORDINATOR.value, _PROCESSES.value, _PROCESS.value)


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


def main(_: list[str]):
    """Hand the parsed flags to the run."""
    hush_jaxlib()
    # Heavy: flags are read first.
    from dpc_jax.run import pipeline, process
    from dpc_jax.run.report.final import judge_finally
    from dpc_jax.run.report.photographs import judge_photographs

    logging.set_verbosity(logging.ERROR)  # JAX tells of each accelerator not found
    path = config_flags.get_config_filename(flags.FLAGS["config"])
    config = from_config_dict(_CONFIG.value)
    run: dict = {"config_path": path, "workdir": _WORKDIR.value}
    if _PHOTOGRAPHS.value:
        status = pipeline.judge_guarded(config, judge=judge_photographs, **run)
    elif _FINAL.value or _FINAL_MESHES.value:
        meshes = _FINAL_MESHES.value
        judge = functools.partial(
            judge_finally, meshes=Path(meshes) if meshes else None
        )
        status = pipeline.judge_guarded(config, judge=judge, **run)
    else:
        status = pipeline.run_guarded(config, place=_find_place(), **run)
    process.leave(status)


def start():
    """Run the command with the flags in `sys.argv`; it ends the process."""
    app.run(main, flags_parser=_parse)


if __name__ == "__main__":
    start()
