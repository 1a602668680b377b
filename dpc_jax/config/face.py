"""The face of a config: what the command line edits, and what a workdir keeps."""

import dataclasses
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from dpc_jax.config.sections import Config

if TYPE_CHECKING:
    import ml_collections


def to_config_dict(config: Config) -> "ml_collections.ConfigDict":
    """The same fields as an editable `ConfigDict`, as `config_flags` wants them."""
    import ml_collections  # of the command line alone

    return ml_collections.ConfigDict(dataclasses.asdict(config))


def from_config_dict(edited: "ml_collections.ConfigDict") -> Config:
    """The frozen record of an edited config.

    Raises:
      ValueError: for a field that is not known, or a value of another type.
    """
    return _read(Config, edited.to_dict(), "config")


def to_json(config: Config) -> str:
    """The config as the text of WORKDIR/config.json."""
    return json.dumps(dataclasses.asdict(config), indent=2) + "\n"


def from_json(text: str) -> Config:
    """The config of a workdir; fields that it lacks have their defaults.

    Raises:
      ValueError: as `from_config_dict`, and for what is not JSON.
    """
    try:
        values = json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deep to be read") from None
    return _read(Config, values, "config")


def _read(kind: type, values: Any, name: str) -> Any:
    """A record of a dataclass from nested dictionaries."""
    if not isinstance(values, Mapping):
        raise ValueError(
            f"{name} must be a section of named fields, but it is {values!r}; leave it "
            "out for its defaults."
        )
    fields = {field.name: field for field in dataclasses.fields(kind)}
    if unknown := sorted(set(values) - set(fields)):
        raise ValueError(
            f"{name} must have no other fields than {', '.join(fields)}, but it has "
            f"{', '.join(unknown)}; remove {'it' if len(unknown) == 1 else 'them'}."
        )
    read = {}
    for field, value in values.items():
        wanted = fields[field].type
        assert isinstance(wanted, type)
        path = f"{name}.{field}"
        if dataclasses.is_dataclass(wanted):
            read[field] = _read(wanted, value, path)
        else:
            read[field] = _convert(wanted, value, path)
    if kind is Config and "category" not in read:  # all others have defaults
        raise ValueError(f"{name} must have the field category, but it is missing.")
    return kind(**read)


def _convert(wanted: type, value: Any, path: str) -> Any:
    """The value in the type of its field; whole numbers may stand for real ones."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if wanted is float and is_number:
        return float(value)
    if type(value) is not wanted:
        raise ValueError(
            f"{path} must be of type {wanted.__name__}, but it is {value!r}; set "
            f"another with --{path}=VALUE."
        )
    return value
