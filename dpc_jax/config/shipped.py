"""The config files that come with the package, by name.

A checkout has them in configs/ beside the package; a wheel in a folder inside it.
"""

from collections.abc import Sequence
from pathlib import Path

_PACKAGE = Path(__file__).parents[1]
_PLACES = (_PACKAGE / "configs", _PACKAGE.parent / "configs")


def list_shipped() -> dict[str, Path]:
    """The config files by name, as "car"."""
    found = {}
    for folder in _PLACES:
        for path in sorted(folder.glob("*.py")):
            found.setdefault(path.stem, path)
    return found


def resolve_flags(arguments: Sequence[str]) -> list[str]:
    """Command line arguments with the names of --config as paths.

    --config=car:paper becomes --config=DIR/car.py:paper, also in two words. What has a
    slash or a suffix is a path already, and what is no name of a config stays.
    """
    shipped, changed = list_shipped(), []
    is_value = False
    for argument in arguments:
        flag, equals, value = argument.partition("=")
        is_flag = flag in ("--config", "-config")
        if is_value:
            argument = _resolve(argument, shipped)
        elif is_flag and equals:
            argument = f"{flag}={_resolve(value, shipped)}"
        is_value = is_flag and not equals
        changed.append(argument)
    return changed


def _resolve(value: str, shipped: dict[str, Path]) -> str:
    name, colon, variant = value.partition(":")
    path = shipped.get(name)
    return value if path is None else f"{path}{colon}{variant}"
