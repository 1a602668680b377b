"""What a view costs: python -m dpc_jax.measure.view_rates

It renders views of procedural shapes, subdivided to a number of faces, in one process,
and prints a Markdown table: views per second by faces and rays per pixel, and the error
at the rim of the silhouette. Judge by processor time if other programs run.
"""

import argparse
import itertools
import statistics
import sys
import time
from collections.abc import Sequence

import numpy as np
import trimesh

from dpc_jax.data import viewpoints, views
from dpc_jax.reporting.tables import format_table
from dpc_jax.shapes import procedural
from dpc_jax.shapes.normalization import face_colors

REFERENCE = 16  # rays per pixel and axis that rims are compared with
COMPARED = 8  # views that they are compared in
HEADS = ("shape", "faces", "rays per pixel", "views/s", "lowest–highest")
HEADS = (*HEADS, "by the clock", "error of rims")


def _divide_faces(mesh, *, faces):
    """The same shape with `faces` faces or up to two more, if it had fewer."""
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    colors = face_colors(mesh)
    while len(triangles) < faces:
        corners = vertices[triangles]
        sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        order = np.argsort(-np.linalg.norm(sides, axis=1), kind="stable")
        # a face becomes four, the largest first
        count = min(len(triangles), -(-(faces - len(triangles)) // 3))
        parts, rest = order[:count], order[count:]
        a, b, c = (vertices[triangles[parts, i]] for i in range(3))
        middles = np.concatenate([(a + b) / 2, (b + c) / 2, (c + a) / 2])
        ab, bc, ca = len(vertices) + np.arange(3 * count).reshape(3, count)
        i, j, k = triangles[parts].T
        made = [(i, ab, ca), (ab, j, bc), (ca, bc, k), (ab, bc, ca)]
        made = np.concatenate([np.stack(corner, axis=1) for corner in made])
        vertices = np.concatenate([vertices, middles])
        colors = np.concatenate([colors[rest], np.tile(colors[parts], (4, 1))])
        triangles = np.concatenate([triangles[rest], made])
    return trimesh.Trimesh(vertices, triangles, face_colors=colors, process=False)


def _draw_views(mesh, *, count, seed=0, **size):
    """Views of a mesh as a data set has them: any azimuth, elevation -20 to 40."""
    scene, rng = views.build_scene(mesh), np.random.default_rng(seed)
    for _ in range(count):
        azimuth, elevation = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-20.0, 40.0)
        rotation = viewpoints.look_at_rotation(azimuth, np.deg2rad(elevation))
        yield views.render_view(scene, rotation, lights=views.draw_lights(rng), **size)


def _measure(mesh, *, count, rounds, **size):
    """Views per second of processor time and by the clock, one value per round each.

    The scene is built in each round, as it is for each model of a set, but once for
    all views of the round.
    """
    rates: tuple[list[float], list[float]] = [], []
    for number in range(rounds):
        starts = time.process_time(), time.perf_counter()
        for _ in _draw_views(mesh, count=count, seed=number, **size):
            pass
        stops = time.process_time(), time.perf_counter()
        for kind, start, stop in zip(rates, starts, stops, strict=True):
            kind.append(count / max(stop - start, 1e-9))
    return rates


def _measure_rims(mesh, **size):
    """Mean error of the coverage of pixels that are partly covered, from 0 to 1."""
    ours = _draw_views(mesh, count=COMPARED, **size)
    exact = _draw_views(mesh, count=COMPARED, **size | {"supersample": REFERENCE})
    errors = []
    for first, second in zip(ours, exact, strict=True):
        rim = (second.mask > 0) & (second.mask < 255)
        errors.append(np.abs(first.mask[rim].astype(float) - second.mask[rim]) / 255.0)
    return float(np.concatenate(errors).mean())


def _make_rows(flags):
    for category, faces in itertools.product(procedural.CATEGORIES, flags.faces):
        mesh = _divide_faces(procedural.make_shape(category, 0), faces=faces)
        for side in flags.rays:
            size = {"image_size": flags.image_size, "supersample": side}
            count, rounds = max(1, flags.views), max(1, flags.rounds)
            busy, passed = _measure(mesh, count=count, rounds=rounds, **size)
            yield (
                category,
                f"{len(mesh.faces):,}",
                f"{side}²",
                f"{statistics.median(busy):.0f}",
                f"{min(busy):.0f}–{max(busy):.0f}",
                f"{statistics.median(passed):.0f}",
                f"{_measure_rims(mesh, **size):.3f}",
            )


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--faces", type=int, nargs="+", default=[10_000, 100_000])
    parser.add_argument("--rays", type=int, nargs="+", default=[2, 4, 8])
    parser.add_argument("--image_size", type=int, default=128)
    parser.add_argument("--views", type=int, default=40, help="in a round")
    parser.add_argument("--rounds", type=int, default=5)
    try:
        rows = list(_make_rows(parser.parse_args(arguments)))
    except ValueError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    print(format_table(HEADS, rows, align="lrrrrrr"), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
