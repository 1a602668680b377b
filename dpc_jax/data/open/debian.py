"""Debian packages, fetched and unpacked with the ordinary commands and without root."""

import os
import shutil
import subprocess
from pathlib import Path

NO_NETWORK = ("resolve", "connect", "Failed to fetch", "timed out", "unreachable")


def fetch_package(name: str, folder: Path) -> Path:
    """Path of a package's file in a folder; it is downloaded if it is not there yet.

    A file NAME_VERSION.deb that somebody has put there is used as it is. What was
    downloaded before an interruption is kept, and apt continues from there.
    """
    if found := _find_package(name, folder):
        return found
    hint = f"put the file {name}_VERSION.deb from any Debian mirror into {folder}"
    _expect_command("apt-get", f"it comes with Debian and Ubuntu; elsewhere {hint}")
    partial = folder / f"{name}.partial"
    partial.mkdir(parents=True, exist_ok=True)
    print(f"Fetching the package {name} with apt-get", flush=True)
    result = _run(["apt-get", "download", name], cwd=partial)
    found = _find_package(name, partial)
    if result.returncode != 0 or found is None:
        last = _last_error(result.stderr)
        if "Unable to locate" in result.stderr or "No packages found" in result.stderr:
            advice = f"run `apt-get update` once as root, or {hint}"
        elif any(word in result.stderr for word in NO_NETWORK):
            advice = f"connect to the network and run this again, or {hint}"
        else:
            advice = f"fix that and run this again, or {hint}"
        raise RuntimeError(
            f"Expected apt-get to download {name}, but it failed ({last}); {advice}."
        )
    path = folder / found.name
    os.replace(found, path)
    shutil.rmtree(partial, ignore_errors=True)
    return path


def _find_package(name, folder):
    """The last by name, or None."""
    found = sorted(folder.glob(f"{name}_*.deb"))
    return found[-1] if found else None


def unpack_package(path: Path, folder: Path) -> Path:
    """Unpack a package's files into a folder, unless that is there already."""
    if folder.is_dir():
        return folder
    _expect_command("dpkg-deb", "install the package dpkg, or use Debian or Ubuntu")
    partial = folder.with_name(f"{folder.name}.tmp")
    shutil.rmtree(partial, ignore_errors=True)  # of a run that was interrupted
    partial.mkdir(parents=True)
    print(f"Unpacking {path.name}", flush=True)
    result = _run(["dpkg-deb", "-x", path.resolve(), partial.resolve()])
    if result.returncode != 0:
        shutil.rmtree(partial, ignore_errors=True)
        raise RuntimeError(
            f"Expected a whole package in {path}, but dpkg-deb cannot unpack it "
            f"({_last_error(result.stderr)}); delete the file and run this again."
        )
    os.replace(partial, folder)
    return folder


def read_version(path: Path) -> str:
    """Version of a package, from the name of its file."""
    return path.stem.split("_")[1].replace("%3a", ":")


def _expect_command(command, advice):
    if shutil.which(command) is None:
        raise RuntimeError(
            f"Expected the command {command}, but it is not installed; {advice}."
        )


def _run(command, **options):
    """Run a command with English messages; its errors are kept, not shown."""
    return subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        env={**os.environ, "LC_ALL": "C"},
        **options,
    )


def _last_error(text):
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith(("E:", "dpkg"))]
    return (errors or lines or ["it gave no reason"])[0]
