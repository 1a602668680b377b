"""The face of a config: its file, what the command line edits, what a workdir keeps."""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dpc_jax.config.sections import Config

if TYPE_CHECKING:
    import ml_collections

# A checkout has its config files beside the package; a wheel in a folder inside it.
_PACKAGE = Path(__file__).parents[1]
_PLACES = (_PACKAGE / "configs", _PACKAGE.parent / "configs")


def list_shipped() -> dict[str, Path]:
    """The config files by name, as "car"."""
    found = {}
    for folder in _PLACES:
        for path in sorted(folder.glob("*.py")):
            found.setdefault(path.stem, path)
    return found


def locate_config(value: str) -> str:
    """The path of a config that --config names: of car:paper, DIR/car.py:paper.

    What has a slash or a suffix is a path already, and what is no name of a config
    stays.
    """
    name, colon, variant = value.partition(":")
    path = list_shipped().get(name)
    return value if path is None else f"{path}{colon}{variant}"


def to_config_dict(config: Config) -> "ml_collections.ConfigDict":
    """The same fields as an editable `ConfigDict`, as `config_flags` wants them."""
    import ml_collections  # of the command line alone

    return ml_collections.ConfigDict(dataclasses.asdict(config))


def to_json(config: Config) -> str:
    """The config as the text of WORKDIR/config.json."""
    return json.dumps(dataclasses.asdict(config), indent=2) + "\n"


def from_fields(values: Any) -> Config:
    """The config of sections of fields; those that it lacks have their defaults.

    Raises:
      ValueError: for a field that is not known, or a value of another type.
    """
    return _read(Config, values, "config")


def list_fields(config: Config) -> dict[str, Any]:
    """Every field by its name, as {"train.steps": 4200}."""
    found = {}
    for name, value in dataclasses.asdict(config).items():
        if isinstance(value, dict):
            found |= {f"{name}.{field}": one for field, one in value.items()}
        else:
            found[name] = value
    return found


def name_differences(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """What differs, with both values: "train.steps (20 there, 40 here)"."""
    return [
        f"{name} ({there.get(name)!r} there, {here.get(name)!r} here)"
        for name in sorted(there.keys() | here.keys())
        if there.get(name) != here.get(name)
    ]


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
