"""Runs as a comparison shows them, read from their workdirs."""

import os
from collections.abc import Sequence
from pathlib import Path

from dpc_jax.config import list_fields
from dpc_jax.learning.training.records import MetricLog
from dpc_jax.outputs import show_text
from dpc_jax.reporting.comparison import tabulate_groups, write_comparison
from dpc_jax.reporting.groups import ComparedRun, group_runs
from dpc_jax.run.workdir import FREE_FIELDS, read_config, read_metrics

# What does not make two runs differ: the variant is a name of other settings.
_LEFT_OUT = (*FREE_FIELDS, "seed", "variant")


def find_workdirs(folders: Sequence[Path]) -> list[Path]:
    """The workdirs among folders, or in them, each once; ValueError without any."""
    found: dict[Path, None] = {}
    for folder in folders:
        inside = [folder] if (folder / "config.json").is_file() else []
        inside = inside or sorted(p.parent for p in folder.glob("*/config.json"))
        if not inside:
            raise ValueError(
                f"Expected the folder of a run, or of several, in {folder}, but no "
                "config.json is there; give the --workdir of a run."
            )
        found |= dict.fromkeys(path.resolve() for path in inside)
    return list(found)


def read_runs(workdirs: Sequence[Path]) -> list[ComparedRun]:
    """What the workdirs hold, finished or not.

    Runs have the names of their folders, with those above them where two are alike.
    """
    names = [path.name for path in workdirs]
    if len(set(names)) < len(names):
        above = Path(os.path.commonpath(workdirs))
        names = [path.relative_to(above).as_posix() for path in workdirs]
    return list(map(_read_run, workdirs, map(show_text, names)))


def _read_run(workdir: Path, name: str) -> ComparedRun:
    config = read_config(workdir)
    fields = list_fields(config).items()
    fields = {n: v for n, v in fields if not n.startswith(_LEFT_OUT)}
    records = MetricLog(workdir / "metrics.jsonl").read()
    metrics = read_metrics(workdir)
    unfinished = ""
    if metrics is None:
        step = max((record.get("step", 0) for record in records), default=0)
        unfinished = f"step {step} of {config.train.steps}"
    return ComparedRun(
        name, config.seed, fields, metrics or {}, tuple(records), unfinished
    )


def compare_runs(workdirs: Sequence[Path], out: Path):
    """Print the table, write the page."""
    groups = group_runs(read_runs(find_workdirs(workdirs)))
    print(tabulate_groups(groups))
    print(f"Page: {show_text(write_comparison(out, groups))}")
