"""Rendering the models of a data set into array files, in one process or several.

Workers are plain Python processes that write rows of memory-mapped `.npy` files; they
report on a pipe, one JSON line per model. They are started with a bare parent package,
because importing the whole package would load jax in each of them, and they are not
forked, because jax runs threads.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from .sources import SPLITS, DataSpec, Source

BOOT = """
import sys, types
package = types.ModuleType("dpc_jax")
package.__path__ = [sys.argv[1]]
sys.modules["dpc_jax"] = package
from dpc_jax.data import rendering
rendering.work(sys.argv[2], part=int(sys.argv[3]), parts=int(sys.argv[4]))
"""
INLINE = 16  # so few models are done before a worker has imported what it needs


def array_shapes(spec, count):
    """Name -> (shape, dtype) of the arrays of a data set of `count` models."""
    lead, size = (count, spec.views), (spec.image_size, spec.image_size)
    return {
        "images": ((*lead, *size, 3), "uint8"),
        "masks": ((*lead, *size), "uint8"),
        "depths": ((*lead, *size), "float32"),
        "quaternions": ((*lead, 4), "float32"),
        "surfaces": ((count, spec.surface_points, 3), "float32"),
    }


def write_plan(folder, spec, sources):
    """Creates the array files and the plan that workers read.

    Raises:
      OSError: if the disk has no room for them.
    """
    for name, (shape, dtype) in array_shapes(spec, len(sources)).items():
        path = Path(folder) / f"{name}.npy"
        np.lib.format.open_memmap(path, mode="w+", dtype=dtype, shape=shape)
        if hasattr(os, "posix_fallocate"):
            # reserved now: a disk that fills up under a mapped file kills the process
            with open(path, "r+b") as file:
                os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
    plan = {"spec": vars(spec), "sources": [list(source) for source in sources]}
    (Path(folder) / "plan.json").write_text(json.dumps(plan), encoding="utf-8")


def read_plan(folder):
    """(spec, sources) as `write_plan` wrote them."""
    plan = json.loads((Path(folder) / "plan.json").read_text(encoding="utf-8"))
    spec = {k: tuple(v) if isinstance(v, list) else v for k, v in plan["spec"].items()}
    return DataSpec(**spec), [Source(*source) for source in plan["sources"]]


def make_model(spec, source):
    """The normalised mesh of one source. Raises ValueError if its file is no use."""
    from . import meshes, procedural

    if source.path is None:
        return procedural.make_shape(spec.category, source.seed)
    mesh = meshes.read_mesh(source.path)
    if source.copy:
        # normalised first, so that the factors meet comparable sides
        seed = [spec.seed, source.copy, int(source.digest[:8], 16)]
        mesh = meshes.scale_randomly(mesh, seed=seed, amount=spec.scale_amount)
    return meshes.normalize(mesh)


def render_models(folder, indices):
    """Renders models into the array files; yields (index, None or reason to skip)."""
    from . import viewpoints, views

    spec, sources = read_plan(folder)
    arrays = {
        name: np.load(Path(folder) / f"{name}.npy", mmap_mode="r+")
        for name in array_shapes(spec, 1)
    }
    for index in indices:
        try:
            mesh = make_model(spec, sources[index])
            arrays["surfaces"][index] = views.sample_surface(
                mesh, count=spec.surface_points, seed=spec.seed
            )
        except ValueError as error:
            yield index, str(error)
            continue
        scene = views.build_scene(mesh)
        # every model has its own stream: any number of processes gives the same views
        rng = np.random.default_rng([spec.seed, SPLITS.index(spec.split), index])
        for view in range(spec.views):
            azimuth = rng.uniform(0.0, 2.0 * np.pi)
            elevation = np.deg2rad(rng.uniform(*spec.elevation))
            rotation = viewpoints.look_at_rotation(azimuth, elevation)
            picture = views.render_view(
                scene,
                rotation,
                lights=views.draw_lights(rng),
                image_size=spec.image_size,
                focal_length=spec.focal_length,
                distance=spec.distance,
                extent=spec.extent,
                supersample=spec.supersample,
            )
            arrays["images"][index, view] = picture.image
            arrays["masks"][index, view] = picture.mask
            arrays["depths"][index, view] = picture.depth
            arrays["quaternions"][index, view] = viewpoints.matrix_to_quaternion(
                rotation
            )
        yield index, None
    for array in arrays.values():
        array.flush()


def work(folder, *, part, parts):
    """Body of a worker: every `parts`-th model, one line on stdout for each."""
    _, sources = read_plan(folder)
    for index, reason in render_models(folder, range(part, len(sources), parts)):
        sys.stdout.write(json.dumps([index, reason and reason[:2000]]) + "\n")
        sys.stdout.flush()


def render_in_processes(folder, *, count, processes):
    """As `render_models` for all models, by worker processes, in order of finishing.

    Raises:
      RuntimeError: if a worker dies; the message holds the end of its error output.
    """
    package = str(Path(__file__).resolve().parent.parent)
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    reader, writer = os.pipe()
    workers, logs = [], []
    try:
        for part in range(processes):
            logs.append(Path(folder) / f"worker-{part}.log")
            command = [sys.executable, "-c", BOOT, package, str(folder)]
            with open(logs[-1], "wb") as log:
                workers.append(
                    subprocess.Popen(
                        [*command, str(part), str(processes)],
                        stdin=subprocess.DEVNULL,
                        stdout=writer,
                        stderr=log,
                        env={**os.environ, **threads},
                        start_new_session=True,  # Ctrl-C reaches us; we end them
                    )
                )
        os.close(writer)
        writer = None
        with open(reader, encoding="utf-8", closefd=False) as lines:
            for line in lines:
                index, reason = json.loads(line)
                yield index, reason
        for part, worker in enumerate(workers):
            if worker.wait() != 0:
                tail = logs[part].read_text(encoding="utf-8", errors="replace")[-2000:]
                raise RuntimeError(
                    f"a rendering process ended with status {worker.returncode}; its "
                    f"last words:\n{tail.strip()}\nRender with one process to "
                    "look closer."
                )
    finally:
        for worker in workers:
            if worker.poll() is None:
                worker.terminate()
            worker.wait()
        os.close(reader)
        if writer is not None:
            os.close(writer)
    for log in logs:
        log.unlink()


def follow(results, *, count, label, progress):
    """Passes results on and shows progress: a bar on a terminal, lines elsewhere."""
    if not progress:
        yield from results
        return
    if sys.stdout.isatty():
        from rich.progress import track

        yield from track(results, description=label, total=count)
        return
    start, shown = time.monotonic(), 0
    for done, result in enumerate(results, start=1):
        yield result
        if 10 * done // count > shown:
            shown = 10 * done // count
            rate = done / max(time.monotonic() - start, 1e-9)
            print(
                f"{label}: {done}/{count} models, {rate:.1f}/s, "
                f"{(count - done) / rate:.0f} s left",
                flush=True,
            )
