"""Fits of objects against the truth: python -m dpc_jax.measure.object_fits MESH...

Each mesh is seen from all around as on a turntable, its camera between 20 degrees below
and 40 above, and fitted with given, rough and no poses. Writes object_fits.json and a
picture of the clouds, and prints a table: overlap of silhouettes, Chamfer distance,
pose errors, seconds. Rough and found frames are brought onto the true one first.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dpc_jax.data.meshes import read_mesh
from dpc_jax.data.viewpoints import look_at_rotation, matrix_to_quaternion
from dpc_jax.data.views import build_scene, draw_lights, render_view, sample_surface
from dpc_jax.evaluation import chamfer_distance, rotations
from dpc_jax.evaluation.alignment import align_by_poses, align_points, align_poses
from dpc_jax.files import write_json
from dpc_jax.learning.fitting.object_fit import FitSettings, fit
from dpc_jax.reporting import gallery, style
from dpc_jax.reporting.tables import format_table
from dpc_jax.run.process import keep_compiled_programs
from dpc_jax.shapes.normalization import normalize

MODES = ("given", "rough", "none")
_ROUGH = np.deg2rad(10.0)  # standard deviation about each axis


class Turntable(NamedTuple):
    """Views of a mesh.

    Attributes:
      images: uint8 [V, S, S, 3]. masks: uint8 [V, S, S].
      poses: [V, 4]. surface: [P, 3].
    """

    images: np.ndarray
    masks: np.ndarray
    poses: np.ndarray
    surface: np.ndarray


def take_turntable(path: Path, *, views: int, side: int, seed: int = 0) -> Turntable:
    """Views of a mesh file from equal steps of azimuth, at random elevations."""
    mesh = normalize(read_mesh(path))
    scene, rng = build_scene(mesh), np.random.default_rng(seed)
    taken, poses = [], []
    for azimuth in 2 * np.pi * np.arange(views) / views:
        rotation = look_at_rotation(azimuth, np.deg2rad(rng.uniform(-20, 40)))
        lights = draw_lights(rng)
        taken.append(render_view(scene, rotation, lights=lights, image_size=side))
        poses.append(matrix_to_quaternion(rotation))
    return Turntable(
        np.stack([view.image for view in taken]),
        np.stack([view.mask for view in taken]),
        np.stack(poses).astype(np.float32),
        sample_surface(mesh),
    )


def measure_fit(
    table: Turntable, mode: str, settings: FitSettings, *, seed: int = 0
) -> tuple[dict[str, Any], np.ndarray]:
    """Figures of one fit, and its cloud [N, 3] in the frame of the mesh.

    Args:
      mode: of `MODES`. seed: of the fit, and of the noise of rough poses.
    """
    given, learn = table.poses, ()
    if mode == "rough":
        noise = _ROUGH * np.random.default_rng(seed).normal(size=(len(given), 3))
        turns = rotations.to_rotation(given)
        turns = type(turns).from_rotvec(noise) * turns
        given, learn = rotations.to_quaternion(turns), ("rotations",)
    started = time.perf_counter()
    found = fit(
        table.masks,
        rotations=None if mode == "none" else np.asarray(given, np.float32),
        learn=learn,
        settings=settings,
        seed=seed,
    )
    seconds = time.perf_counter() - started
    points, poses = found.points, found.rotations
    if mode != "given":
        frame = align_by_poses(poses[:, None], table.poses[:, None])
        points, poses = align_points(frame, points), align_poses(frame, poses)
    errors = rotations.angle_deg(poses, table.poses)
    chamfer = chamfer_distance(points, table.surface)
    figures = {
        "poses": mode,
        "overlap": float(found.overlaps.mean()),
        "least_overlap": float(found.overlaps.min()),
        "chamfer": 100 * (chamfer.precision + chamfer.coverage),
        "precision": 100 * chamfer.precision,
        "coverage": 100 * chamfer.coverage,
        "pose_accuracy": float(np.mean(errors < 30)),
        "pose_median_error_deg": float(np.median(errors)),
        "seconds": seconds,
        "loss": found.curve[-1]["loss"],
    }
    return figures, points


def draw_fits(
    tables: Sequence[Turntable], clouds: Sequence[Sequence[np.ndarray]], path: Path
) -> Path:
    """A row for each object: a view, the true surface, and the cloud of each mode."""
    titles = ("a view", "true surface", *(f"poses: {mode}" for mode in MODES))
    figure = style.make_figure(1.9 * len(titles), 2.0 * len(tables) + 0.3)
    panels = style.make_panels(figure, len(titles) * len(tables), columns=len(titles))
    for row, (table, fitted) in enumerate(zip(tables, clouds, strict=True)):
        first, *others = panels[row * len(titles) : (row + 1) * len(titles)]
        first.imshow(table.images[2])
        for axes, points in zip(others, (table.surface[::3], *fitted), strict=True):
            gallery.draw_cloud(axes, points)
        for axes, title in zip((first, *others), titles, strict=True):
            axes.set(xticks=[], yticks=[])
            if row == 0:
                axes.set_title(title, fontsize=9, color=style.INK)
    return style.save_figure(figure, path)


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, fit, write; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("meshes", nargs="+", type=Path, metavar="MESH")
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--side", type=int, default=128, help="of the images")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/object_fits"))
    options = parser.parse_args(arguments)
    keep_compiled_programs()
    settings = FitSettings()
    records, tables, clouds = [], [], []
    try:
        for path in options.meshes:
            table = take_turntable(path, views=options.views, side=options.side)
            tables.append(table)
            clouds.append([])
            for mode in MODES:
                figures, cloud = measure_fit(table, mode, settings, seed=options.seed)
                clouds[-1].append(cloud)
                records.append({"object": path.stem} | figures)
                print(f"{path.stem}, {mode}: {figures['seconds']:.0f} s", flush=True)
    except (ValueError, OSError) as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    write_json(options.out / "object_fits.json", records)
    names = {
        "object": "Object",
        "poses": "Poses",
        "overlap": "Overlap",
        "chamfer": "Chamfer",
        "precision": "Precision",
        "coverage": "Coverage",
        "pose_accuracy": "Within 30°",
        "pose_median_error_deg": "Median (°)",
        "seconds": "Seconds",
    }
    rows = [
        [f"{v:.3g}" if isinstance(v, float) else str(v) for v in map(r.get, names)]
        for r in records
    ]
    print(format_table(list(names.values()), rows))
    print(f"Picture: {draw_fits(tables, clouds, options.out / 'object_fits.png')}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
