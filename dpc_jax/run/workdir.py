"""The folder of a run: the config that it belongs to, and its canonical alignment."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.config import Config, from_fields, list_fields, name_differences, to_json
from dpc_jax.evaluation.alignment import Alignment
from dpc_jax.files import (
    Damage,
    claiming,
    locate_claim,
    read_json,
    read_text,
    reading,
    write_json,
    write_text,
)
from dpc_jax.outputs import trying_to_write

# What may differ between a run and its continuation.
FREE_FIELDS = (
    "data.cache_dir",
    "log",
    "render.renders_at_once",
    "run",
)
_ALIGNMENT = Path("report") / "alignment.json"


@contextlib.contextmanager
def hold_workdir(workdir: Path) -> Iterator[None]:
    """Make the workdir, and keep other commands from training in it meanwhile.

    Raises:
      ValueError: where another process holds it, naming that process.
      OSError: where it cannot be made or written.
    """
    with contextlib.ExitStack() as held:
        with trying_to_write(workdir, "--workdir=DIR"):
            is_ours = held.enter_context(claiming(workdir / "run"))
        if not is_ours:
            holder = "another one"
            with contextlib.suppress(OSError):  # it has just ended
                holder = f"process {read_text(locate_claim(workdir / 'run'))}"
            raise ValueError(
                f"The workdir {workdir} must be used by one command at a time, but "
                f"{holder} is using it; wait for it to end, or give another "
                "--workdir=DIR."
            )
        yield


def claim_workdir(workdir: Path, config: Config) -> Path:
    """Write the config into the workdir, or check that it is this config's.

    To be called by the command that holds the workdir.
    """
    path = workdir / "config.json"
    if path.exists():
        other = read_config(workdir)  # of a run: what is not may be anybody's
        made = [workdir / "checkpoints", workdir / "metrics.jsonl"]
        if any(one.exists() for one in made):
            check_same(workdir, other, config)
    write_text(path, to_json(config))
    return workdir


def check_same(workdir: Path, other: Config, config: Config):
    """Refuse a config that is not that of the workdir's run, but for `FREE_FIELDS`."""
    if differing := list_differences(other, config):
        raise ValueError(
            f"The workdir {workdir} must belong to this config, but it was made by "
            f"another one, which differs in {', '.join(differing)}; give another "
            "--workdir=DIR or the old values (--config.SECTION.FIELD=VALUE)."
        )


def list_differences(old: Config, new: Config) -> list[str]:
    """Fields that keep a config from going on with a run of another one.

    Each with both values, see `name_differences`.
    """
    differing = name_differences(list_fields(old), list_fields(new))
    return [text for text in differing if not text.startswith(FREE_FIELDS)]


_AGAIN = (
    "remove it and start the command that began the run again, which writes it anew"
)


def read_config(workdir: Path) -> Config:
    """The config of a run; fields that it did not know yet have their defaults.

    Raises:
      ValueError: where the folder holds none, or one that cannot be read.
    """
    path = workdir / "config.json"
    with reading(
        "the config of a run", path, "give the --workdir of a run of dpc_jax.main"
    ):
        return from_fields(read_json(path))


def read_metrics(workdir: Path) -> dict[str, Any] | None:
    """The metrics of a run's report; None without one, ValueError where damaged."""
    path = workdir / "report" / "metrics.json"
    if not path.is_file():
        return None
    with reading("the metrics of a run", path, _AGAIN):
        return dict(read_json(path))


def write_alignment(workdir: Path, alignment: Alignment) -> Path:
    """Keep the canonical alignment, so that later predictions stand upright."""
    fields = {n: np.asarray(v).tolist() for n, v in alignment._asdict().items()}
    return write_json(workdir / _ALIGNMENT, fields)


def read_alignment(workdir: Path) -> Alignment | None:
    """The canonical alignment of a run; None without one, ValueError where damaged."""
    path = workdir / _ALIGNMENT
    if not path.is_file():
        return None
    with reading("the alignment of a run", path, _AGAIN):
        fields = read_json(path)
        rotation = np.array(fields["rotation"], np.float64).reshape(4)
        if not 0.9 < np.linalg.norm(rotation) < 1.1:
            raise Damage(f"{rotation.tolist()} is no unit quaternion")
        return Alignment(rotation, float(fields["inlier_share"]))
