"""Meshes anyone can get: fetched, unpacked and converted, one category a call.

The folder of a category holds `train` and, where a part is kept for other ends, `test`
or `reserved`: PLY files in the canonical frame, beside each a JSON file with licence
and origin, and `families.json`, which keeps the variants of a design on one side of a
split. `models.json` lists all and is written last.
"""

import contextlib
import hashlib
import json
import os
import shutil
import tempfile
import zipfile
from pathlib import Path

from dpc_jax.data import meshes
from dpc_jax.data.look import contact_sheet
from dpc_jax.data.open import debian, flightgear, sweethome3d, torcs, trigger_rally
from dpc_jax.data.progress import follow
from dpc_jax.shapes.normalization import normalize

RECIPES = {
    "chair": (sweethome3d,),
    "car": (torcs, trigger_rally, sweethome3d),
    "airplane": (flightgear,),
}
VERSION = 1  # raise it when a converted mesh changes
SHEET_VIEW = 96  # pixels
SCRATCH = ".making-"  # begins the names of folders for a moment


def fetch_category(category, out, *, progress=True):
    """Makes the folder OUT/CATEGORY of open meshes, or goes on with it.

    A second call does nothing. Packages stay in OUT/packages; what is unpacked of them
    is removed again. A model that was changed since is kept as NAME.ply.changed.

    Args:
      category: "chair", "car" or "airplane".
      out: folder; created where missing.
      progress: whether to tell on stdout what is done.

    Returns:
      Path of OUT/CATEGORY.

    Raises:
      ValueError: for another category, or if no model can be read.
      RuntimeError: if a command, the network or a package is missing or damaged, or
        another process is at work in the folder.
      OSError: if a file cannot be written.
    """
    if category not in RECIPES:
        raise ValueError(
            f"category must be one of {', '.join(RECIPES)}, got {category!r}."
        )
    out = Path(out)
    folder, packages = out / category, out / "packages"
    packages.mkdir(parents=True, exist_ok=True)
    with _lock(packages):
        if not _is_complete(folder):
            _make_folder(category, folder, packages, progress=progress)
        if progress:
            print(describe_folder(folder))
    return folder


def describe_folder(folder):
    """What a finished folder of a category holds, as text."""
    record = json.loads((Path(folder) / "models.json").read_text(encoding="utf-8"))
    lines = []
    for side in ("train", "test", "reserved"):
        listed = [m for m in record["models"].values() if m["side"] == side]
        if listed:
            families = len({model["family"] for model in listed})
            lines.append(f"{folder}/{side}: {len(listed)} models, {families} families")
    lines += [f"skipped {name}: {why}" for name, why in record["skipped"].items()]
    return "\n".join([*lines, f"{folder}/sheet.png shows them"])


@contextlib.contextmanager
def _lock(packages):
    try:
        import fcntl
    except ImportError:  # only on systems that have no apt either
        yield
        return
    with open(packages / "lock", "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RuntimeError(
                f"expected to be alone in {packages.parent}, another process fetches "
                "into it; wait for it to end, or give another folder."
            ) from None
        yield


def _make_folder(category, folder, packages, *, progress):
    models, versions, makers = [], {}, {}
    for module in RECIPES[category]:
        path = debian.fetch_package(module.PACKAGE, packages)
        root = debian.unpack_package(path, packages / module.PACKAGE)
        versions[module.PACKAGE] = debian.read_version(path)
        makers[module.PACKAGE] = module.make_mesh
        models += _list_models(module, root, category, path)
    folder.mkdir(exist_ok=True)
    for scratch in folder.glob(f"{SCRATCH}*"):  # of a run that was killed
        shutil.rmtree(scratch)
    skipped, records = {}, {}

    def make_all():
        for model in models:
            origin = {"package": f"{model.package} {versions[model.package]}"}
            try:
                record = _make_model(model, folder, makers[model.package], origin)
                records[f"{model.side}/{model.name}.ply"] = record
            except ValueError as error:
                skipped[model.name] = str(error)
            yield model.name

    for _ in follow(
        make_all(),
        count=len(models),
        label=f"Converting {category}",
        progress=progress,
    ):
        pass
    if not records:
        first = next(iter(skipped.values()), "the packages hold none")
        raise ValueError(
            f"expected models of {category} in {', '.join(versions)}, got none: {first}"
        )
    for side in sorted({record["side"] for record in records.values()}):
        families = {
            Path(name).name: record["family"]
            for name, record in records.items()
            if record["side"] == side
        }
        _write_json(folder / side / "families.json", families)
    _draw_sheet(folder, records)
    _write_json(
        folder / "models.json",
        {
            "version": VERSION,
            "packages": versions,
            "models": records,
            "skipped": skipped,
        },
    )
    for package in versions:
        shutil.rmtree(packages / package)


def _list_models(module, root, category, path):
    try:
        found, reason = module.list_models(root, category), "it holds no models"
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        found, reason = [], error
    if not found:
        raise RuntimeError(
            f"expected the models of {module.PACKAGE} in {path}, they are not there "
            f"({reason}); delete the file and run this again."
        )
    return found


def _make_model(model, folder, make_mesh, origin):
    """Writes one model and the file beside it, unless they are there; its record."""
    path = folder / model.side / f"{model.name}.ply"
    path.parent.mkdir(exist_ok=True)
    beside = path.with_suffix(".json")
    if record := _read_record(path):
        return record
    if path.exists() and beside.exists():
        path.replace(path.with_name(f"{path.name}.changed"))
    with tempfile.TemporaryDirectory(dir=folder, prefix=SCRATCH) as scratch:
        mesh = normalize(make_mesh(model, Path(scratch)))
        partial = Path(scratch) / "mesh.ply"
        mesh.export(partial)
        record = {
            "version": VERSION,
            "family": model.family,
            "side": model.side,
            **model.origin,
            **origin,
            "changes": "axes, place and size; one colour per face; parts joined",
            "faces": len(mesh.faces),
            "sha256": _digest(partial),
        }
        os.replace(partial, path)
    _write_json(beside, record)
    return record


def _read_record(path):
    """What lies beside a model that is as it was written, or None."""
    try:
        record = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
        same = record["version"] == VERSION and record["sha256"] == _digest(path)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return record if same else None


def _is_complete(folder):
    try:
        record = json.loads((folder / "models.json").read_text(encoding="utf-8"))
        names, sides = record["models"], {n.split("/")[0] for n in record["models"]}
        return (
            record["version"] == VERSION
            and all(_read_record(folder / name) for name in names)
            and all((folder / side / "families.json").is_file() for side in sides)
            and (folder / "sheet.png").is_file()
        )
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _draw_sheet(folder, records):
    """Writes the contact sheet of the models, the families side by side."""
    names = sorted(records, key=lambda n: (records[n]["side"], records[n]["family"], n))
    texts = []
    for name in names:
        family = records[name]["family"]
        other = "" if family == Path(name).stem else f"  ({family})"
        texts.append(f"{name.removesuffix('.ply')}{other}")
    pictures = (meshes.read_mesh(folder / name) for name in names)
    sheet = contact_sheet.draw_models(pictures, texts, size=SHEET_VIEW)
    partial = folder / "sheet.png.tmp"
    sheet.save(partial, format="png")
    os.replace(partial, folder / "sheet.png")


def _write_json(path, record):
    partial = path.with_name(f"{path.name}.tmp")
    partial.write_text(
        json.dumps(record, indent=1, ensure_ascii=False), encoding="utf-8"
    )
    os.replace(partial, path)


def _digest(path):
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
