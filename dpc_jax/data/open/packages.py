"""Debian packages, fetched and unpacked with the ordinary commands and without root."""

import os
import shutil
import subprocess
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh


class OpenModel(NamedTuple):
    """One model of a package, before its mesh is made.

    name: unique in its category. family: models of one family are variants of one
    design. side: "train" or "test". origin: licence, author and file, for
    the JSON file beside the model. source: what the package's module needs to make it.
    """

    name: str
    family: str
    side: str
    origin: dict
    source: tuple


def fetch_package(name: str, folder: Path) -> Path:
    """Path of a package's file in a folder; it is downloaded if it is not there yet.

    A file NAME_VERSION.deb that somebody has put there is used as it is. What was
    downloaded before an interruption is kept, and apt continues from there.
    """
    pattern = f"{name}_*.deb"
    if found := max(folder.glob(pattern), default=None):
        return found
    partial = folder / f"{name}.partial"
    partial.mkdir(parents=True, exist_ok=True)
    print(f"Fetching the package {name} with apt-get", flush=True)
    advice = "connect to the network, run `apt-get update` once as root, or put the "
    advice += f"file {name}_VERSION.deb from any Debian mirror into {folder}"
    _run(["apt-get", "download", name], advice, folder=partial)
    path = folder / next(partial.glob(pattern)).name
    os.replace(partial / path.name, path)
    shutil.rmtree(partial, ignore_errors=True)
    return path


def unpack_package(path: Path, folder: Path) -> Path:
    """Unpack a package's files into a folder, unless that is there already."""
    if folder.is_dir():
        return folder
    partial = folder.with_name(f"{folder.name}.tmp")
    shutil.rmtree(partial, ignore_errors=True)  # of a run that was interrupted
    partial.mkdir(parents=True)
    print(f"Unpacking {path.name}", flush=True)
    advice = "install the package dpkg, or delete the file if it is damaged, and run "
    advice += "this again"
    _run(["dpkg-deb", "-x", str(path.resolve()), str(partial.resolve())], advice)
    os.replace(partial, folder)
    return folder


def _run(command, advice, *, folder=None):
    """Run a command; what it says if it fails is in English."""
    try:
        subprocess.run(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env={**os.environ, "LC_ALL": "C"},
            check=True,
        )
    except FileNotFoundError:
        raise RuntimeError(
            f"Expected the command {command[0]}, but it is not installed; {advice}."
        ) from None
    except subprocess.CalledProcessError as error:
        lines = [line.strip() for line in error.stderr.splitlines() if line.strip()]
        errors = [line for line in lines if line.startswith(("E:", "dpkg"))]
        reason = (errors or lines or ["it gave no reason"])[0]
        raise RuntimeError(
            f"Expected `{' '.join(command)}` to work, but it failed ({reason}); "
            f"{advice}."
        ) from None


def extract_model(archive: Path, member: str, folder: Path) -> Path:
    """Unpack a member of a zip archive with all that lies beside it; its path."""
    beside = f"{Path(member).parent}/"
    with zipfile.ZipFile(archive) as content:
        names = [name for name in content.namelist() if name.startswith(beside)]
        content.extractall(folder, names)
    return folder / member


def move_vertices(
    mesh: trimesh.Trimesh,
    axes: Sequence[int] = (0, 1, 2),
    scale: Sequence[float] | float = 1.0,
    shift: Sequence[float] | np.ndarray | None = None,
) -> trimesh.Trimesh:
    """The mesh with its axes reordered, then scaled, then shifted, in place."""
    moved = np.asarray(mesh.vertices)[:, list(axes)] * scale
    mesh.vertices = moved if shift is None else moved + shift
    return mesh
