"""Completion of the command dpc_jax in bash and zsh, by argcomplete.

The shell starts the command at each press of the key: only the flags of the command on
the line are looked up.
"""

import argparse
import dataclasses
import importlib
import os
import shlex
from collections.abc import Callable
from typing import Any

import argcomplete
from argcomplete.completers import DirectoriesCompleter

from dpc_jax.commands import COMMANDS
from dpc_jax.config import VARIANTS, Config, list_shipped

_FOLDERS = ("workdir", "workdirs", "out", "folder", "data")  # flags that name one


def complete():
    """Answer the shell and end the process."""
    argcomplete.autocomplete(make_parser(_read_words()), always_complete_options=False)


def _read_words() -> list[str]:
    """The words of the line so far."""
    line = os.environ.get("COMP_LINE", "")[: int(os.environ.get("COMP_POINT", 0))]
    try:
        return shlex.split(line)
    except ValueError:  # an open quote
        return line.split()


def make_parser(words: list[str]) -> argparse.ArgumentParser:
    """A parser of the whole command, with the flags of the one among the words."""
    parser = argparse.ArgumentParser("dpc_jax")
    places = parser.add_subparsers()
    for name, command in COMMANDS.items():
        if name not in words[1:2]:
            places.add_parser(name, help=command.text)
            continue
        module = importlib.import_module(command.module)
        made = module.make_parser()
        if name == "train":
            _add_fields(made, words[-1])
        _choose_completers(made)
        places.add_parser(name, parents=[made], add_help=False, help=command.text)
    return parser


def _add_fields(parser: argparse.ArgumentParser, word: str):
    """The fields of a config as flags, once one is begun: there are many."""
    for section in dataclasses.fields(Config) if word.startswith("--config.") else ():
        if not dataclasses.is_dataclass(section.type):
            parser.add_argument(f"--config.{section.name}")
            continue
        for field in dataclasses.fields(section.type):
            parser.add_argument(f"--config.{section.name}.{field.name}")


def _choose_completers(parser: argparse.ArgumentParser):
    """Folders where a folder is asked for; else files, or the choices of a flag."""
    for action in parser._actions:
        if action.dest in _FOLDERS:
            _set_completer(action, DirectoriesCompleter())
        elif action.dest == "config":
            _set_completer(action, complete_config)
        elif isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                _choose_completers(inner)


def _set_completer(action: argparse.Action, completer: Callable):
    setattr(action, "completer", completer)  # noqa: B010  argcomplete looks for it


def complete_config(prefix: str, **_others: Any) -> list[str]:
    """Names of shipped configs, and after a colon their variants, with commas between.

    Args:
      prefix: what is there of the value.
    """
    shipped = list_shipped()
    name, colon, variant = prefix.partition(":")
    if not colon:
        return [*shipped, *(f"{name}:" for name in shipped if name == prefix)]
    done, comma, _ = variant.rpartition(",")
    given = done.split(",")
    return [f"{name}:{done}{comma}{other}" for other in VARIANTS if other not in given]
