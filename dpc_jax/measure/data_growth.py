"""How a data set scales with its number of models.

python -m dpc_jax.measure.data_growth --models=7000 --image_size=128

It prepares procedural models, reads them back as training does, damages a shard and has
it made again; it prints rate, memory and disk as a Markdown table. After an
interruption it continues; the rate is then that of the models still missing.
"""

import argparse
import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dpc_jax.data import batches, dataset, workers
from dpc_jax.data.sources import open_source
from dpc_jax.data.spec import DataSpec


def _measure(
    spec, *, cache_dir, processes=None, models_per_batch=4, views_per_batch=4, seed=0
):
    """Rows (what, value) on preparing and reading the data set of a specification."""
    rows = []
    missing = _count_missing(spec, cache_dir)
    start = time.monotonic()
    data = dataset.load_or_render(spec, cache_dir=cache_dir, processes=processes)
    seconds = time.monotonic() - start
    if missing:
        rows.append(("models prepared", f"{missing} in {seconds:.0f} s"))
        rows.append(("models per second", f"{missing / seconds:.2f}"))
        rows.append(("views per second", f"{missing * spec.views / seconds:.1f}"))
        largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        rows.append(("memory of the largest worker", f"{largest / 2**10:.0f} MB"))
    folder = _find_folder(spec, cache_dir)
    size = sum(path.stat().st_size for path in folder.iterdir())
    rows.append(("disk", f"{size / 1e9:.2f} GB in {len(list(folder.iterdir()))} files"))

    start = time.monotonic()
    data = dataset.load_or_render(spec, cache_dir=cache_dir)
    rows.append(("checked and opened", f"{time.monotonic() - start:.1f} s"))

    before, most = _read_memory(), 0
    count = -(-len(data.names) // models_per_batch)
    start, processor = time.monotonic(), time.process_time()
    for step in range(count):
        chosen = batches.choose_batch(
            len(data.names),
            data.counts,
            seed=seed,
            step=step,
            models_per_batch=models_per_batch,
            views_per_batch=views_per_batch,
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


def _find_folder(spec, cache_dir):
    source = open_source(spec)
    return dataset.locate_cache(source, source.list_models(), cache_dir)


def _count_missing(spec, cache_dir):
    source, folder = open_source(spec), _find_folder(spec, cache_dir)
    plan = workers.plan_shards(source, source.list_models())
    return sum(
        len(models)
        for number, models in enumerate(plan)
        if not (folder / workers.name_shard(number)).is_file()
    )


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
        spec = DataSpec(
            options.category,
            models=options.models,
            views=options.views,
            image_size=options.image_size,
        )
        rows = _measure(
            spec, cache_dir=options.cache_dir, processes=options.processes or None
        )
    except (ValueError, OSError) as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    print("\n| measured | value |\n| --- | ---: |")
    for row in rows:
        print(f"| {row[0]} | {row[1]} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
