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

NO_NETWORK = ("resolve", "connect", "Failed to fetch", "timed out", "unreachable")


class OpenModel(NamedTuple):
    """One model of a package, before its mesh is made.

    name: unique in its category. family: models of one family are variants of one
    design. side: "train", "test" or "reserved". origin: licence, author and file, for
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
    hint = f"put the file {name}_VERSION.deb from any Debian mirror into {folder}"
    _expect_command("apt-get", f"it comes with Debian and Ubuntu; elsewhere {hint}")
    partial = folder / f"{name}.partial"
    partial.mkdir(parents=True, exist_ok=True)
    print(f"Fetching the package {name} with apt-get", flush=True)
    status, errors = _run(["apt-get", "download", name], folder=partial)
    found = max(partial.glob(pattern), default=None)
    if status != 0 or found is None:
        advice = "fix that and run this again"
        if "Unable to locate" in errors or "No packages found" in errors:
            advice = "run `apt-get update` once as root"
        elif any(word in errors for word in NO_NETWORK):
            advice = "connect to the network and run this again"
        raise RuntimeError(
            f"Expected apt-get to download {name}, but it failed "
            f"({_name_error(errors)}); {advice}, or {hint}."
        )
    path = folder / found.name
    os.replace(found, path)
    shutil.rmtree(partial, ignore_errors=True)
    return path


def unpack_package(path: Path, folder: Path) -> Path:
    """Unpack a package's files into a folder, unless that is there already."""
    if folder.is_dir():
        return folder
    _expect_command("dpkg-deb", "install the package dpkg, or use Debian or Ubuntu")
    partial = folder.with_name(f"{folder.name}.tmp")
    shutil.rmtree(partial, ignore_errors=True)  # of a run that was interrupted
    partial.mkdir(parents=True)
    print(f"Unpacking {path.name}", flush=True)
    status, errors = _run(["dpkg-deb", "-x", path.resolve(), partial.resolve()])
    if status != 0:
        shutil.rmtree(partial, ignore_errors=True)
        raise RuntimeError(
            f"Expected a whole package in {path}, but dpkg-deb cannot unpack it "
            f"({_name_error(errors)}); delete the file and run this again."
        )
    os.replace(partial, folder)
    return folder


def _expect_command(command, advice):
    if shutil.which(command) is None:
        raise RuntimeError(
            f"Expected the command {command}, but it is not installed; {advice}."
        )


def _run(command, *, folder=None):
    """Run a command with English messages; its status and its errors."""
    done = subprocess.run(
        command,
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        env={**os.environ, "LC_ALL": "C"},
    )
    return done.returncode, done.stderr


def _name_error(text):
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith(("E:", "dpkg"))]
    return (errors or lines or ["it gave no reason"])[0]


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
