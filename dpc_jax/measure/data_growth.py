"""How a data set scales with its number of models.

python -m dpc_jax.measure.data_growth --models=7000 --image_size=128

It prepares procedural models, reads them back as training does, damages a shard and has
it made again. After an interruption the rate is that of the models still missing.
"""

import argparse
import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dpc_jax.data import batches, dataset
from dpc_jax.data.shard_plan import name_shard, plan_shards
from dpc_jax.data.sources import open_source
from dpc_jax.data.spec import DataSpec
from dpc_jax.reporting.tables import format_table


def _measure(spec, *, cache_dir, processes=None):
    """Rows (what, value) on preparing and reading the data set of a specification."""
    rows = []
    folder, missing = _locate(spec, cache_dir)
    start = time.monotonic()
    data = dataset.load_or_render(spec, cache_dir=cache_dir, processes=processes)
    seconds = time.monotonic() - start
    if missing:
        rows.append(("models prepared", f"{missing} in {seconds:.0f} s"))
        rows.append(("models per second", f"{missing / seconds:.2f}"))
        rows.append(("views per second", f"{missing * spec.views / seconds:.1f}"))
        largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        rows.append(("memory of the largest worker", f"{largest / 2**10:.0f} MB"))
    size = sum(path.stat().st_size for path in folder.iterdir())
    rows.append(("disk", f"{size / 1e9:.2f} GB in {len(list(folder.iterdir()))} files"))

    start = time.monotonic()
    data = dataset.load_or_render(spec, cache_dir=cache_dir)
    rows.append(("checked and opened", f"{time.monotonic() - start:.1f} s"))

    before, most = _read_memory(), 0
    size = {"models_per_batch": 4, "views_per_batch": 4}
    count = -(-len(data.names) // size["models_per_batch"])
    start, processor = time.monotonic(), time.process_time()
    for step in range(count):
        chosen = batches.choose_batch(
            len(data.names), data.counts, seed=0, step=step, **size
        )
        batches.read_batch(data, *chosen)
        if step % 50 == 0:
            most = max(most, _read_memory() - before)
    seconds, busy = time.monotonic() - start, time.process_time() - processor
    rows.append(("a batch", f"{1e3 * seconds / count:.2f} ms, {count} in an epoch"))
    rows.append(("of which processor time", f"{1e3 * busy / count:.2f} ms"))
    rows.append(("memory that an epoch adds", f"{most:.0f} MB"))

    victim = sorted(folder.glob("*.npz"))[0]
    expected = np.array(data.masks[0])
    content = bytearray(victim.read_bytes())
    content[len(content) // 2] ^= 1
    victim.unlink()  # the old file stays mapped
    victim.write_bytes(content)
    start = time.monotonic()
    again = dataset.load_or_render(spec, cache_dir=cache_dir, processes=processes)
    seconds = time.monotonic() - start
    same = np.array_equal(again.masks[0], expected)
    rows.append(("a damaged shard made again", f"{seconds:.1f} s, equal: {same}"))
    return rows


def _locate(spec, cache_dir):
    """The cache folder of a specification, and how many models it lacks."""
    source = open_source(spec)
    models = source.list_models()
    folder = dataset.locate_cache(source, models, cache_dir)
    missing = sum(
        len(part)
        for number, part in enumerate(plan_shards(source, models))
        if not (folder / name_shard(number)).is_file()
    )
    return folder, missing


def _read_memory():
    """Resident memory of this process in MB, mapped files included; 0 if unknown."""
    status = Path("/proc/self/status")
    if not status.is_file():
        return 0
    return int(status.read_text().split("VmRSS:")[1].split()[0]) / 2**10


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--category", default="car")
    parser.add_argument("--models", type=int, default=7000)
    parser.add_argument("--views", type=int, default=5)
    parser.add_argument("--image_size", type=int, default=128)
    parser.add_argument("--cache_dir", type=Path, default=Path("data"))
    parser.add_argument("--processes", type=int, default=0, help="0: one per core")
    options = parser.parse_args(arguments)
    try:
        fields = ("category", "models", "views", "image_size")
        spec = DataSpec(**{name: getattr(options, name) for name in fields})
        processes = options.processes or None
        rows = _measure(spec, cache_dir=options.cache_dir, processes=processes)
    except (ValueError, OSError) as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    print("\n" + format_table(("measured", "value"), rows, align="lr"), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
