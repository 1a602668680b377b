"""Random input: what no list of examples has."""

import dataclasses

import pytest
from config_files import FOLDER, refuse_flags
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dpc_jax.config import Config


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


# ml_collections loads a config file by a method that Python has deprecated.
@pytest.mark.filterwarnings("ignore:the load_module:DeprecationWarning:importlib")
@pytest.mark.parametrize("tries", [100, pytest.param(2000, marks=pytest.mark.slow)])
def test_every_value_of_a_config_works_or_is_refused_in_a_line(tries):
    @settings(max_examples=tries)
    @example({"config.train.steps": 10**20})
    @example({"config.data.meshes": "m" * 300})
    @given(CHANGES)
    def change(changes):
        words = [f"--config={FOLDER / 'debug.py'}"]
        said = refuse_flags(words + [f"--{name}={v}" for name, v in changes.items()])
        if said is not None:
            assert said and "\n" not in said and "Traceback" not in said

    change()
