"""Splits that others have published, and splits of our own, as lists of models.

Read are the forms that ShapeNet users have on disk: the comma-separated `all.csv`
(columns id, synsetId, subSynsetId, modelId, split), one text file per split
(`SYNSET_train.txt`, a model a line), and the serialised table `SYNSET.file` that the
paper's split was first published in.
"""

import csv
import os
from pathlib import Path

SPLITS = ("train", "val", "test")
SYNONYMS = {"validation": "val", "valid": "val", "training": "train", "testing": "test"}


def find_split(folder, synset):
    """Where the official split of a synset lies in or beside a folder, or None.

    Looked for are `all.csv`, `SYNSET.file` and `SYNSET_train.txt`, each in the folder
    itself, in its `splits`, in its synset's folder and in the folder above.
    """
    folder = Path(folder)
    places = [folder, folder / "splits", folder / synset, folder.parent / "splits"]
    for name in ("all.csv", f"{synset}.file", f"{synset}_train.txt"):
        for place in places:
            if (place / name).is_file():
                return place / name
    return None


def read_split(path, synset):
    """Model ids of a synset by split, in the order of the file: `{"train": [...], ...}`

    Args:
      path: a CSV file, a `.file` table, or any one of the text files of the splits.
      synset: eight digits; a CSV file may leave out leading zeros.

    Raises:
      ValueError: naming the file, if it cannot be understood, names a model twice, or
        has no model of the synset.
      OSError: if it cannot be read.
    """
    path = Path(path)
    try:
        if path.suffix == ".csv":
            sides = _read_csv(path, synset)
        elif path.suffix == ".file":
            sides = _read_table(path)
        else:
            sides = _read_texts(path)
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(
            f"expected text in {path}, it cannot be read ({error}); give another file."
        ) from None
    listed = [model for side in sides.values() for model in side]
    if not listed:
        raise ValueError(
            f"expected models of {synset} with the splits {', '.join(SPLITS)} in "
            f"{path}, found none; give the split file of this synset."
        )
    if len(set(listed)) < len(listed):
        twice = sorted(listed)
        twice = next(a for a, b in zip(twice, twice[1:], strict=False) if a == b)
        raise ValueError(
            f"expected every model once in {path}, {twice} is there twice; repair it."
        )
    return sides


def _read_csv(path, synset):
    sides = {split: [] for split in SPLITS}
    with open(path, encoding="utf-8", newline="") as file:
        rows = csv.DictReader(file)
        missing = {"synsetId", "modelId", "split"} - set(rows.fieldnames or ())
        if missing:
            raise ValueError(
                f"expected the columns synsetId, modelId and split in {path}, "
                f"{', '.join(sorted(missing))} is missing; give another file."
            )
        for row in rows:
            side = SYNONYMS.get(row["split"], row["split"])
            if (row["synsetId"] or "").zfill(8) == synset and side in sides:
                if not row["modelId"]:
                    raise ValueError(
                        f"expected a modelId in every row of {path}, line "
                        f"{rows.line_num} has none; repair it."
                    )
                sides[side].append(row["modelId"])
    return sides


def _read_texts(path):
    """The text files of all splits, from the path of one of them."""
    stem = next((s for s in SPLITS if path.stem.endswith(s)), None)
    if stem is None:
        raise ValueError(
            f"expected a file named SYNSET_train.txt, SYNSET_val.txt or "
            f"SYNSET_test.txt, got {path}; name the split in its name."
        )
    sides = {}
    for split in SPLITS:
        sibling = path.with_name(f"{path.stem.removesuffix(stem)}{split}{path.suffix}")
        if not sibling.is_file():
            raise ValueError(f"expected {sibling} beside {path}, found none; add it.")
        lines = sibling.read_text(encoding="utf-8").split()
        sides[split] = [line.rsplit("/", 1)[-1] for line in lines]
    return sides


def _read_table(path):
    """A Torch table in its ASCII form: numbers, strings and tables, a token a line."""
    lines = iter(path.read_text(encoding="utf-8").split("\n"))

    def read():
        kind = next(lines)
        if kind == "1":
            return float(next(lines))
        if kind == "2":
            length, text = int(next(lines)), next(lines)
            if len(text) != length:
                raise ValueError(f"{text!r} is not {length} characters long")
            return text
        if kind == "3":
            _, count = next(lines), int(next(lines))
            return {read(): read() for _ in range(count)}
        raise ValueError(f"a value of the unknown kind {kind!r}")

    try:
        table = read()
        return {
            split: [text for _, text in sorted(table.get(split, {}).items())]
            for split in SPLITS
        }
    except (ValueError, StopIteration, AttributeError, RuntimeError) as error:
        raise ValueError(
            f"expected a table of splits in {path}, it cannot be read "
            f"({error or 'it ends too early'}); give another split file."
        ) from None


def write_split(path, sides, synset):
    """Writes a split in the form of `all.csv`, unless the file is there already."""
    path = Path(path)
    if path.exists():
        return
    rows = [(model, split) for split, models in sides.items() for model in models]
    partial = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    try:
        with open(partial, "w", encoding="utf-8", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(["id", "synsetId", "subSynsetId", "modelId", "split"])
            for number, (model, split) in enumerate(sorted(rows)):
                table.writerow([number, synset, synset, model, split])
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
