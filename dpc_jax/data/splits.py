"""Splits of models into train, val and test: seeded, or by published lists.

Seeded splits never part the variants of one design. Lists are read as ShapeNet users
have them on disk: the comma-separated `all.csv` (columns id, synsetId, subSynsetId,
modelId, split), or one text file per split (`SYNSET_train.txt`, a model per line), as
released with the paper's code.
"""

import csv
from collections import Counter
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.files import Damage, read_json, reading

SPLITS = ("train", "val", "test")
FINAL = "final"  # of procedural shapes: a test set by which nothing is chosen


def split_files(
    paths: Sequence[Any],
    *,
    fractions: Sequence[float],
    seed: int,
    groups: Sequence[Hashable] | None = None,
    fold: tuple[int, int] | None = None,
) -> tuple[list, list, list]:
    """Seeded split of distinct paths or names into (train, val, test), each sorted.

    Files of one group (of equal content, say) stay on one side; by default each is a
    group of its own. Every side with a positive fraction gets at least one group as
    long as there are enough. Only the ratios of the fractions count.

    With `fold` = (i, n) the groups, in their seeded order, are n parts of like size, of
    which the i-th is tested, and the fractions of train and val share the others. So
    over all i each group is tested once.

    Raises:
      ValueError: if there are fewer groups than parts.
    """
    shares = np.asarray(fractions, dtype=np.float64)
    members = {}
    for path, key in sorted(zip(paths, groups or paths, strict=True)):
        members.setdefault(key, []).append(path)
    ordered = list(members.values())
    order = np.random.default_rng(seed).permutation(len(ordered))
    if fold is None:
        counts = _count_groups(shares, len(ordered))
        parts = np.split(order, np.cumsum(counts)[:-1])
    else:
        tested, others = _take_fold(order, *fold)
        counts = _count_groups(shares * [1, 1, 0], len(others))
        parts = [*np.split(others, np.cumsum(counts)[:-1])[:2], tested]
    train, val, test = (
        sorted(path for i in chosen for path in ordered[i]) for chosen in parts
    )
    return train, val, test


def _count_groups(shares, total):
    """How many of the groups each side gets."""
    counts = np.floor(shares / shares.sum() * total + 1e-9).astype(int)
    counts[np.argmax(shares)] += total - counts.sum()
    for side in np.flatnonzero((shares > 0) & (counts == 0)):
        if counts.max() > 1:
            counts[np.argmax(counts)] -= 1
            counts[side] = 1
    return counts


def _take_fold(order, index, count):
    """The index-th of `count` parts of an order, and the others."""
    if count > len(order):
        raise ValueError(
            f"Expected at least as many families of files as folds, but there are "
            f"{len(order)} and data.fold asks for {count}; ask for fewer or add files."
        )
    first, last = (len(order) * i // count for i in (index, index + 1))
    return order[first:last], np.concatenate([order[last:], order[:first]])


def group_variants(paths: Sequence[Path], digests: Sequence[str]) -> list[str]:
    """One key per file; files of equal content or of one family share it.

    Families are read from `families.json` in a file's folder, which maps file names to
    families. Without it, only equal files belong together.
    """
    from scipy.cluster.hierarchy import DisjointSet

    named = {}
    for place in {path.parent for path in paths}:
        listed = place / "families.json"
        if not listed.is_file():
            continue
        with reading("families by the names of files", listed):
            known = read_json(listed)
            named |= {place / name: f"family {known[name]}" for name in known}
    # two families that share a file are one
    groups = DisjointSet([*digests, *named.values()])
    for path, own in zip(paths, digests, strict=True):
        groups.merge(own, named.get(path, own))
    return [groups[own] for own in digests]


def find_split(folder: Path, synset: str) -> Path | None:
    """Where the official split of a synset lies in or beside a folder, or None.

    `all.csv` and `SYNSET_train.txt` are looked for in this order, each in the folder
    itself, in its `splits`, in its synset's folder and in `splits` beside the folder.
    """
    places = [folder, folder / "splits", folder / synset, folder.parent / "splits"]
    for name in ("all.csv", f"{synset}_train.txt"):
        for place in places:
            if (place / name).is_file():
                return place / name
    return None


def read_split(path: Path, synset: str) -> dict[str, list[str]]:
    """Model ids of a synset by split, in the order of the file.

    The path is that of a CSV file, which may leave out leading zeros of the synset, or
    of any one of the text files.
    """
    cure = "repair it or give another split file"
    with reading(f"models of {synset} by split", path, cure):
        is_csv = path.suffix == ".csv"
        sides = _read_csv(path, synset) if is_csv else _read_texts(path)
        listed = Counter(model for side in sides.values() for model in side)
        if not listed:
            raise Damage(f"found none with the splits {', '.join(SPLITS)}")
        if twice := sorted(model for model, count in listed.items() if count > 1):
            raise Damage(f"{twice[0]} is there twice")
    return sides


def _read_csv(path, synset):
    sides = {split: [] for split in SPLITS}
    with open(path, encoding="utf-8", newline="") as file:
        rows = csv.DictReader(file)
        missing = {"synsetId", "modelId", "split"} - set(rows.fieldnames or ())
        if missing:
            raise Damage(f"its column {', '.join(sorted(missing))} is missing")
        for row in rows:
            side = sides.get(row["split"])
            if (row["synsetId"] or "").zfill(8) == synset and side is not None:
                if not row["modelId"]:
                    raise Damage(f"line {rows.line_num} has no modelId")
                side.append(row["modelId"])
    return sides


def _read_texts(path):
    stem = next((s for s in SPLITS if path.stem.endswith(s)), None)
    if stem is None:
        raise Damage("it is named otherwise than SYNSET_train.txt, _val and _test")
    sides = {}
    for split in SPLITS:
        sibling = path.with_name(f"{path.stem.removesuffix(stem)}{split}{path.suffix}")
        if not sibling.is_file():
            raise Damage(f"{sibling.name} beside it is missing")
        lines = sibling.read_text(encoding="utf-8").split()
        sides[split] = [line.rsplit("/", 1)[-1] for line in lines]
    return sides
