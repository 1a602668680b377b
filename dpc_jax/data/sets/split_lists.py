"""Lists of the models of a split, published ones and our own.

Three forms are read, those that ShapeNet users have on disk: the comma-separated
`all.csv` (columns id, synsetId, subSynsetId, modelId, split), one text file per split
(`SYNSET_train.txt`, a model per line), and the serialised table `SYNSET.file` in which
the paper's split was first published.
"""

import csv
import io
from collections import Counter
from pathlib import Path
from typing import Any

from dpc_jax import files
from dpc_jax.data.splits import SPLITS
from dpc_jax.files import Damage

SYNONYMS = {"validation": "val", "valid": "val", "training": "train", "testing": "test"}


def find_split(folder: Path, synset: str) -> Path | None:
    """Where the official split of a synset lies in or beside a folder, or None.

    `all.csv`, `SYNSET.file` and `SYNSET_train.txt` are looked for in this order, each
    in the folder itself, in its `splits`, in its synset's folder and in `splits` beside
    the folder.
    """
    places = [folder, folder / "splits", folder / synset, folder.parent / "splits"]
    for name in ("all.csv", f"{synset}.file", f"{synset}_train.txt"):
        for place in places:
            if (place / name).is_file():
                return place / name
    return None


def read_split(path: Path, synset: str) -> dict[str, list[str]]:
    """Model ids of a synset by split, in the order of the file.

    The path is that of a CSV file, which may leave out leading zeros of the synset, of
    a `.file` table, or of any one of the text files.
    """
    readers = {".csv": lambda path: _read_csv(path, synset), ".file": _read_table}
    try:
        sides = readers.get(path.suffix, _read_texts)(path)
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(
            f"Expected text in {path}, but it cannot be read ({error}); give another "
            "file."
        ) from None
    listed = Counter(model for side in sides.values() for model in side)
    if not listed:
        raise ValueError(
            f"Expected models of {synset} with the splits {', '.join(SPLITS)} in "
            f"{path}, but found none; give the split file of this synset."
        )
    if twice := sorted(model for model, count in listed.items() if count > 1):
        raise ValueError(
            f"Expected every model once in {path}, but {twice[0]} is there twice; "
            "repair it."
        )
    return sides


def _read_csv(path, synset):
    sides = {split: [] for split in SPLITS}
    with open(path, encoding="utf-8", newline="") as file:
        rows = csv.DictReader(file)
        missing = {"synsetId", "modelId", "split"} - set(rows.fieldnames or ())
        if missing:
            raise ValueError(
                f"Expected the columns synsetId, modelId and split in {path}, but "
                f"{', '.join(sorted(missing))} is missing; give another file."
            )
        for row in rows:
            side = SYNONYMS.get(row["split"], row["split"])
            if (row["synsetId"] or "").zfill(8) == synset and side in sides:
                if not row["modelId"]:
                    raise ValueError(
                        f"Expected a modelId in every row of {path}, but line "
                        f"{rows.line_num} has none; repair it."
                    )
                sides[side].append(row["modelId"])
    return sides


def _read_texts(path):
    stem = next((s for s in SPLITS if path.stem.endswith(s)), None)
    if stem is None:
        raise ValueError(
            f"Expected a file named SYNSET_train.txt, SYNSET_val.txt or "
            f"SYNSET_test.txt, but got {path}; name the split in its name."
        )
    sides = {}
    for split in SPLITS:
        sibling = path.with_name(f"{path.stem.removesuffix(stem)}{split}{path.suffix}")
        if not sibling.is_file():
            raise ValueError(
                f"Expected {sibling} beside {path}, but it is missing; add it."
            )
        lines = sibling.read_text(encoding="utf-8").split()
        sides[split] = [line.rsplit("/", 1)[-1] for line in lines]
    return sides


def _read_table(path):
    """Splits from a Torch table in ASCII form, which has one token per line."""
    lines = iter(path.read_text(encoding="utf-8").split("\n"))

    def read():
        kind = next(lines)
        if kind == "1":
            return float(next(lines))
        if kind == "2":
            length, text = int(next(lines)), next(lines)
            if len(text) != length:
                raise Damage(f"{text!r} is not {length} characters long")
            return text
        if kind == "3":
            _, count = next(lines), int(next(lines))
            return {read(): read() for _ in range(count)}
        raise Damage(f"a value of the unknown kind {kind!r}")

    try:
        table: Any = read()
        return {
            split: [text for _, text in sorted(table.get(split, {}).items())]
            for split in SPLITS
        }
    except (ValueError, StopIteration, AttributeError, RuntimeError) as error:
        raise ValueError(
            f"Expected a table of splits in {path}, but it cannot be read "
            f"({error or 'it ends too early'}); give another split file."
        ) from None


def write_split(path: Path, sides: dict[str, list[str]], synset: str):
    """Write a split in the form of `all.csv`, unless the file is there already."""
    if path.exists():
        return
    rows = [(model, split) for split, models in sides.items() for model in models]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["id", "synsetId", "subSynsetId", "modelId", "split"])
    for number, (model, split) in enumerate(sorted(rows)):
        table.writerow([number, synset, synset, model, split])
    files.write_text(path, text.getvalue())
