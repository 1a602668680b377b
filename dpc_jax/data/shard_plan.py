"""Which models of a data set go into which shard, and whether a shard is as planned."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dpc_jax.data import shards
from dpc_jax.data.sources import Model, Source
from dpc_jax.files import Damage

SHARD_MODELS = (4, 64)  # fewest and most in a shard
SHARD_BYTES = 64 << 20  # a worker holds one shard in memory


def plan_shards(source: Source, models: Sequence[Model]) -> list[range]:
    """Which models go into which shard: ranges of indices, in order.

    The plan depends on the models alone, so that any number of processes, and a process
    that continues where another has stopped, write the same files.
    """
    few, many = SHARD_MODELS
    most = min(max(few, -(-len(models) // 16)), many)
    plan, start, size = [], 0, 0
    for index, model in enumerate(models):
        size += source.estimate_bytes(model)
        if index > start and (index - start == most or size > SHARD_BYTES):
            plan.append(range(start, index))
            start, size = index, source.estimate_bytes(model)
    return [*plan, range(start, len(models))]


def name_shard(number: int) -> str:
    """File name of a shard."""
    return f"shard-{number:05d}.npz"


def identify_shard(folder: str | Path, models: range) -> dict[str, Any]:
    """What tells a shard from those of other sets and other models."""
    return {"set": Path(folder).name, "models": [models.start, models.stop]}


def find_damage(folder: str | Path, models: range, number: int) -> str | None:
    """What is wrong with a shard that should hold these models; "" where nothing is.

    None where there is no such file.
    """
    try:
        record = shards.read_record(Path(folder) / name_shard(number))
        expected = identify_shard(folder, models)
        if {name: record.get(name) for name in expected} != expected:
            raise Damage("it belongs to another set or other models")
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        return str(error)
    return ""
