"""The folder of a run: the config that it belongs to, and its canonical alignment."""

import json
import os
from pathlib import Path

import ml_collections
import numpy as np

from dpc_jax.config import defaults
from dpc_jax.evaluation.alignment import Alignment
from dpc_jax.files import write_text
from dpc_jax.run import configuration

_ALIGNMENT = Path("report") / "alignment.json"


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
        old = flatten_fields(json.loads(read_config(workdir).to_json()))
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


def read_config(workdir: Path) -> ml_collections.ConfigDict:
    """The config of a run; fields that it did not know yet have their defaults.

    Raises:
      ValueError: where the folder holds none, or one that cannot be read.
    """
    path = workdir / "config.json"
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
        config = defaults.default_config(fields["category"]).unlock()
        config.update(fields)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"Expected the config of a run in {path}, which cannot be read "
            f"({error}); give the --workdir of a run of dpc_jax.main."
        ) from None
    return config


def write_alignment(workdir: Path, alignment: Alignment) -> Path:
    """Keep the canonical alignment, so that later predictions stand upright."""
    fields = {
        name: np.asarray(value).tolist()
        for name, value in alignment._asdict().items()
        if np.all(np.isfinite(value))
    }
    return write_text(workdir / _ALIGNMENT, json.dumps(fields, indent=2) + "\n")


def read_alignment(workdir: Path) -> Alignment | None:
    """The canonical alignment of a finished run; None where there is none.

    Raises:
      ValueError: where the file is damaged.
    """
    path = workdir / _ALIGNMENT
    if not path.is_file():
        return None
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
        rotation = np.array(fields.pop("rotation"), np.float64).reshape(4)
        unknown = dict.fromkeys(Alignment._fields, np.nan)
        return Alignment(**unknown | fields | {"rotation": rotation})
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"Expected a rotation in {path}, which cannot be read ({error}); remove it "
            "and start the run again, which writes it anew."
        ) from None


def flatten_fields(tree: dict, prefix: str = "") -> dict:
    """Nested dictionaries to one with dotted names."""
    flat = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            flat |= flatten_fields(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat
