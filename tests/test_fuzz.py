"""Random input: what no list of examples has."""

import contextlib
import dataclasses
import io
import sys
from unittest import mock

import pytest
from absl import flags
from config_files import FOLDER
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dpc_jax import main
from dpc_jax.config import Config, check, from_config_dict

# The config, from the words of a command line.


def list_fields(kind=Config, path="config"):
    for field in dataclasses.fields(kind):
        name = f"{path}.{field.name}"
        if dataclasses.is_dataclass(field.type):
            yield from list_fields(field.type, name)
        else:
            yield name


WORDS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]))
VALUES = st.integers(-(10**30), 10**30) | st.floats() | st.booleans() | WORDS
CHANGES = st.dictionaries(st.sampled_from(sorted(list_fields())), VALUES, max_size=3)


def read_config(changes):
    """Read flags as the command does; what it says where they are refused."""
    words = [f"--config={FOLDER / 'debug.py'}"]
    argv = ["main.py", *words, *(f"--{name}={v}" for name, v in changes.items())]
    before = set(flags.FLAGS)
    with (
        mock.patch.object(sys, "argv", argv),
        contextlib.redirect_stderr(io.StringIO()) as error,
    ):
        try:
            main._parse(argv)
            check(from_config_dict(main._CONFIG.value))
        except SystemExit as caught:
            assert caught.code == 2
            return error.getvalue()
        except ValueError as caught:  # is said by the command as a sentence
            return f"Error: {caught}\n"
        finally:
            flags.FLAGS.unparse_flags()
            for name in set(flags.FLAGS) - before:
                delattr(flags.FLAGS, name)


# ml_collections loads a config file by a method that Python has deprecated.
@pytest.mark.filterwarnings("ignore:the load_module:DeprecationWarning:importlib")
@pytest.mark.parametrize("tries", [100, pytest.param(2000, marks=pytest.mark.slow)])
def test_every_value_of_a_config_works_or_is_refused_in_a_line(tries):
    @settings(max_examples=tries)
    @example({"config.train.steps": 10**20})
    @example({"config.data.meshes": "m" * 300})
    @given(CHANGES)
    def change(changes):
        said = read_config(changes)
        if said is not None:
            assert said.startswith("Error: ") and said.count("\n") == 1
            assert "Traceback" not in said

    change()
