"""Preparing the shards of a data set, in one process or several.

Workers are plain Python processes that write whole shards; they are told which on their
input and report on a pipe, one JSON line per model. They are not forked, because jax
runs threads.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from dpc_jax.data import shards
from dpc_jax.data.spec import SPLITS, DataSpec, Source

BOOT = """
import sys
from dpc_jax.data import rendering
rendering.work(sys.argv[1], part=int(sys.argv[2]))
"""
INLINE = 16  # so few models are done before a worker has imported what it needs
SHARD_MODELS = (4, 64)  # fewest and most in a shard
SHARD_BYTES = 64 << 20  # a worker holds one shard in memory


def estimate_bytes(spec, source):
    """Size of a model's rows."""
    pixels = spec.image_size**2 * source.views
    if spec.kind == "images":
        return 4 * pixels
    points = spec.surface_points
    if spec.surface_voxel > 0:  # surfaces are about as large as their boxes' sides
        points = min(points, round(2 / spec.surface_voxel**2))
    return 8 * pixels + 12 * points


def plan_shards(spec, sources):
    """Which models go into which shard: `range`s of indices, in order.

    The plan depends on the models alone, so that any number of processes, and a process
    that goes on where another has stopped, write the same files.
    """
    few, many = SHARD_MODELS
    most = min(max(few, -(-len(sources) // 16)), many)
    plan, start, size = [], 0, 0
    for index, source in enumerate(sources):
        size += estimate_bytes(spec, source)
        if index > start and (index - start == most or size > SHARD_BYTES):
            plan.append(range(start, index))
            start, size = index, estimate_bytes(spec, source)
    return [*plan, range(start, len(sources))]


def name_shard(number):
    """File name of a shard."""
    return f"shard-{number:05d}.npz"


def identify_shard(folder, models):
    """What tells a shard from those of other sets and other models."""
    return {"set": Path(folder).name, "models": [models.start, models.stop]}


def make_model(spec, source):
    """The normalised mesh of one source. Raises ValueError if its file is no use."""
    from dpc_jax.data import meshes
    from dpc_jax.data.sets import shapenet
    from dpc_jax.shapes import procedural
    from dpc_jax.shapes.normalization import normalize

    if source.path is None:
        return procedural.make_shape(spec.category, source.seed)
    mesh = meshes.read_mesh(source.path)
    if spec.kind == "shapenet":
        mesh.vertices = (
            mesh.vertices @ shapenet.find_turn(source.path, spec.shapenet_front).T
        )
    if source.copy:
        # normalised first, so that the factors meet comparable sides
        seed = [spec.seed, source.copy, int(source.digest[:8], 16)]
        mesh = meshes.scale_randomly(mesh, seed=seed, amount=spec.stretch)
    return normalize(mesh)


def make_arrays(spec, source, index):
    """Rows of one model: (arrays by name, remarks).

    Arrays are images, masks, depths and quaternions, one row per view, and surfaces,
    one row per point; own images and training renders lack some.

    Raises:
      ValueError: naming the file, if the model is no use.
    """
    shared = {
        "image_size": spec.image_size,
        "focal_length": spec.focal_length,
        "distance": spec.distance,
    }
    if spec.kind == "images":
        from dpc_jax.data.sets import image_folder

        place = Path(source.path)
        return image_folder.read_object(place, crop=spec.crop, fill=spec.fill, **shared)
    if spec.kind == "renders":
        from dpc_jax.data.sets import listings, released_renders, shapenet

        synset, _ = shapenet.find_synset(spec.folder, spec.category)
        truths = released_renders.find_ground_truth(
            spec.folder, synset, spec.ground_truth
        )
        truth = listings.find_truth(spec, truths, source.name)
        place = Path(source.path)
        arrays = released_renders.read_model(place, truth, views=spec.views, **shared)
        return arrays, []
    arrays = render_model(spec, source, index)
    if not str(source.path).lower().endswith(".obj") or source.copy:
        return arrays, []
    from dpc_jax.data.sets import shapenet

    # other OBJ files may have colours of their own
    remark = shapenet.describe_materials(source.path)
    bare = spec.kind != "shapenet" and remark == shapenet.BARE
    return arrays, [remark] if remark and not bare else []


def render_model(spec, source, index):
    """Rendered views and surface points of one mesh, as `make_arrays` gives them."""
    from dpc_jax.data import surfaces, viewpoints, views

    mesh = make_model(spec, source)
    scene = views.build_scene(mesh)
    surfaces = surfaces.make_ground_truth(mesh, spec, scene=scene)
    size = (spec.views, spec.image_size, spec.image_size)
    arrays = {
        "images": np.empty((*size, 3), np.uint8),
        "masks": np.empty(size, np.uint8),
        "depths": np.empty(size, np.float32),
        "quaternions": np.empty((spec.views, 4), np.float32),
    }
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
        arrays["images"][view] = picture.image
        arrays["masks"][view] = picture.mask
        arrays["depths"][view] = picture.depth
        arrays["quaternions"][view] = viewpoints.matrix_to_quaternion(rotation)
    return arrays | {"surfaces": surfaces}


def write_shards(folder, spec, sources, numbers):
    """Prepares and writes shards; yields (index, None or reason to skip) per model.

    Raises:
      OSError: naming the file, if it cannot be written.
    """
    plan = plan_shards(spec, sources)
    for number in numbers:
        record = identify_shard(folder, plan[number])
        record |= {"names": [], "counts": {}, "skipped": [], "remarks": []}
        rows = {}
        for index in plan[number]:
            name, reason = sources[index].name, None
            try:
                arrays, remarks = make_arrays(spec, sources[index], index)
            except ValueError as error:
                reason = str(error)
                record["skipped"].append([name, reason])
            else:
                record["names"].append(name)
                record["remarks"] += [[name, remark] for remark in remarks]
                for key, array in arrays.items():
                    rows.setdefault(key, []).append(array)
            if index < plan[number].stop - 1:
                yield index, reason
        record["counts"] = {key: [len(a) for a in part] for key, part in rows.items()}
        joined = {key: np.concatenate(part) for key, part in rows.items()}
        shards.write_shard(Path(folder) / name_shard(number), joined, record)
        # the last model counts as done when it is safe
        yield index, reason


def work(folder, *, part):
    """Body of a worker: writes the shards it is told, a line on stdout per model."""
    plan = json.loads(sys.stdin.readline())
    spec = {k: tuple(v) if isinstance(v, list) else v for k, v in plan["spec"].items()}
    spec, sources = DataSpec(**spec), [Source(*source) for source in plan["sources"]]

    def tell(*message):
        sys.stdout.write(json.dumps([part, *message]) + "\n")
        sys.stdout.flush()

    try:
        tell("ready")
        for line in sys.stdin:
            for index, reason in write_shards(folder, spec, sources, [int(line)]):
                tell("model", index, reason and reason[:1000])
            tell("ready")
    except OSError as error:
        tell("failed", str(error)[:1000])


def render_in_processes(folder, spec, sources, numbers, *, processes):
    """As `write_shards`, by worker processes, in order of finishing.

    Raises:
      OSError: if a shard cannot be written.
      RuntimeError: if a worker dies; the message holds the end of its error output.
    """
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    plan = {"spec": vars(spec), "sources": [list(source) for source in sources]}
    waiting = list(reversed(numbers))
    reader, writer = os.pipe()
    workers, logs = [], []
    try:
        for part in range(min(processes, len(numbers))):
            logs.append(tempfile.TemporaryFile())
            workers.append(
                subprocess.Popen(
                    [sys.executable, "-c", BOOT, str(folder), str(part)],
                    stdin=subprocess.PIPE,
                    stdout=writer,
                    stderr=logs[-1],
                    env={**os.environ, **threads},
                    start_new_session=True,  # Ctrl-C reaches us; we end them
                    text=True,
                )
            )
        os.close(writer)
        writer = None
        for worker in workers:
            _send(worker, json.dumps(plan))
        with open(reader, encoding="utf-8", closefd=False) as lines:
            for line in lines:
                part, kind, *message = json.loads(line)
                if kind == "model":
                    yield tuple(message)
                elif kind == "failed":
                    raise OSError(message[0])
                elif waiting:
                    _send(workers[part], waiting.pop())
                else:
                    _close(workers[part])
        for part, worker in enumerate(workers):
            if worker.wait() != 0:
                logs[part].seek(0)
                tail = logs[part].read().decode("utf-8", errors="replace")[-2000:]
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
            _close(worker)
        for log in logs:
            log.close()
        os.close(reader)
        if writer is not None:
            os.close(writer)


def _send(worker, message):
    try:
        worker.stdin.write(f"{message}\n")
        worker.stdin.flush()
    except BrokenPipeError:
        pass  # it has died, which its status will tell


def _close(worker):
    try:
        worker.stdin.close()
    except BrokenPipeError:
        pass  # it has died, which its status will tell


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
