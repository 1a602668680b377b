"""The folder of a run, and the config that it belongs to."""

import json
import os
from pathlib import Path

import ml_collections

from dpc_jax import configuration
from dpc_jax.reporting.files import write_text


def claim_workdir(workdir: Path, config: ml_collections.ConfigDict) -> Path:
    """Make the workdir and write its config, or check that it is this config's.

    Raises:
      ValueError: where another config made it.
      OSError: where it cannot be written.
    """
    try:
        workdir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(
            f"The workdir {workdir} cannot be made ({error.strerror}); give a folder "
            "that can be written with --workdir=DIR."
        ) from None
    if not os.access(workdir, os.W_OK):
        raise OSError(
            f"The workdir {workdir} cannot be written; give another with --workdir=DIR."
        )
    path = workdir / "config.json"
    fields = flatten_fields(json.loads(config.to_json()))
    if path.exists():
        old = flatten_fields(json.loads(path.read_text(encoding="utf-8")))
        differing = sorted(
            name
            for name in fields.keys() | old.keys()
            if fields.get(name) != old.get(name)
            and not name.startswith(configuration.FREE_FIELDS)
        )
        if differing:
            listed = ", ".join(
                f"{n} ({old.get(n)!r} there, {fields.get(n)!r} now)" for n in differing
            )
            raise ValueError(
                f"The workdir {workdir} was made by another config, which differs in "
                f"{listed}; give another --workdir=DIR or the old values."
            )
    write_text(path, json.dumps(json.loads(config.to_json()), indent=2) + "\n")
    return workdir


def flatten_fields(tree: dict, prefix: str = "") -> dict:
    """Nested dictionaries to one with dotted names."""
    flat = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            flat |= flatten_fields(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat
