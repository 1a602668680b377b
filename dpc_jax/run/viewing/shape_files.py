"""Shapes from files of `predict`, `fit`, a report or another program."""

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from dpc_jax.files import describe_error, read_bytes, read_json
from dpc_jax.outputs import show_text
from dpc_jax.reporting.export import export_glb
from dpc_jax.run.viewing import ShownObject, ShownView

ENDINGS = (".ply", ".glb", ".obj")
_MOST = 2**28  # bytes of a GLB file


def read_shapes(paths: list[Path]) -> list[ShownObject]:
    """The shapes of files and of folders of such; a cloud and its surface are one.

    Files of one name belong together, `NAME-surface` too. Poses are read from
    `NAME.json` or `fit.json` beside them.

    Raises:
      ValueError: where a file holds no shape, or there is none.
    """
    files = [file for path in paths for file in _list_files(path)]
    found: dict[Path, ShownObject] = {}
    for file in files:
        stem = file.with_name(file.stem.removesuffix("-surface"))
        one = found.get(stem) or ShownObject(show_text(stem.name))
        shape = _read_shape(file)
        if file.suffix.lower() == ".glb":
            one = one._replace(surface=read_bytes(file, most=_MOST))
        elif isinstance(shape, trimesh.Trimesh):
            visual: Any = shape.visual
            is_colored = visual.kind == "vertex"
            colors = visual.vertex_colors[:, :3] / 255 if is_colored else None
            surface = export_glb(shape.vertices, shape.faces, colors)
            one = one._replace(surface=surface)
        else:
            one = one._replace(points=np.asarray(shape.vertices, np.float32))
            if (colors := _read_colors(shape)) is not None:
                one = one._replace(colors=colors)
        found[stem] = one
    return [one._replace(views=_read_views(stem)) for stem, one in found.items()]


def _list_files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = [p for p in sorted(path.iterdir()) if p.suffix.lower() in ENDINGS]
    if not found:
        raise ValueError(
            f"Expected a run or shapes ({', '.join(ENDINGS)}) in the folder {path}, "
            "but it has neither; give a workdir, or a folder that predict or fit wrote."
        )
    return found


def _read_shape(path: Path) -> Any:
    """A `trimesh.Trimesh`, or a `trimesh.PointCloud`."""
    if path.suffix.lower() not in ENDINGS:
        raise ValueError(
            f"Expected a file that ends with {', '.join(ENDINGS)}, but it is {path}; "
            "convert it, or give a run."
        )
    try:
        loaded: Any = trimesh.load(path, process=False)
        if isinstance(loaded, trimesh.Scene):
            loaded = trimesh.util.concatenate(loaded.dump())
        if not len(loaded.vertices) or not np.isfinite(loaded.vertices).all():
            raise ValueError("it holds no finite points")
    except Exception as error:  # readers of foreign formats raise what they like
        raise ValueError(
            f"Expected a shape in {path}, but it cannot be read "
            f"({describe_error(error)}); open it with the program that wrote it."
        ) from None
    return loaded


def _read_colors(cloud) -> np.ndarray | None:
    colors = np.asarray(cloud.colors) if cloud.colors is not None else np.zeros(0)
    return colors[:, :3] / 255 if colors.shape[:1] == cloud.vertices.shape[:1] else None


def _read_views(stem: Path) -> tuple[ShownView, ...]:
    """Of the JSON file that `predict` or `fit` wrote beside a cloud, if it did."""
    for path in (stem.with_name(f"{stem.name}.json"), stem.with_name("fit.json")):
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            facts = read_json(path)
            views = facts.get("views", [facts])
            rows = views.values() if isinstance(views, dict) else views
            poses = [np.asarray(view["quaternion"], float) for view in rows]
            if all(pose.shape == (4,) for pose in poses):
                return tuple(map(ShownView, poses))
    return ()
