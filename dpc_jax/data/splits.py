"""Seeded splits of files, which never part the variants of one design."""

import json
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

SPLITS = ("train", "val", "test")


def split_files(
    paths: Sequence[Any],
    *,
    fractions: Sequence[float],
    seed: int,
    groups: Sequence[Hashable] | None = None,
) -> tuple[list, list, list]:
    """Seeded split of distinct paths or names into (train, val, test), each sorted.

    Files of one group (of equal content, say) stay on one side; by default each is a
    group of its own. Every side with a positive fraction gets at least one group as
    long as there are enough. Only the ratios of the fractions count.

    Raises:
      ValueError: if the fractions are not three shares with a positive sum.
    """
    shares = np.asarray(fractions, dtype=np.float64)
    if shares.shape != (3,) or not (shares >= 0).all() or not shares.sum() > 0:
        raise ValueError(
            "fractions must be three shares (train, val, test), none negative and not "
            f"all zero, but they are {fractions}; use (0.8, 0.1, 0.1) for instance."
        )
    members = {}
    for path, key in sorted(zip(paths, groups or paths, strict=True)):
        members.setdefault(key, []).append(path)
    ordered = list(members.values())
    order = np.random.default_rng(seed).permutation(len(ordered))
    counts = np.floor(shares / shares.sum() * len(ordered) + 1e-9).astype(int)
    counts[np.argmax(shares)] += len(ordered) - counts.sum()
    for side in np.flatnonzero((shares > 0) & (counts == 0)):
        if counts.max() > 1:
            counts[np.argmax(counts)] -= 1
            counts[side] = 1
    train, val, test = (
        sorted(path for i in chosen for path in ordered[i])
        for chosen in np.split(order, np.cumsum(counts)[:-1])
    )
    return train, val, test


def group_variants(paths: Sequence[Path], digests: Sequence[str]) -> list[str]:
    """One key per file; files of equal content or of one family share it.

    Families are read from `families.json` in a file's folder, which maps file names to
    families. Without it, only equal files belong together.
    """
    named = {}
    for place in {path.parent for path in paths}:
        listed = place / "families.json"
        if not listed.is_file():
            continue
        try:
            known = json.loads(listed.read_text(encoding="utf-8"))
            named |= {place / name: f"family {known[name]}" for name in known}
        except (OSError, ValueError, TypeError) as error:
            raise ValueError(
                f"Expected {listed} to map file names to families, but it cannot be "
                f"read ({error}); repair or remove it."
            ) from error
    # two families that share a file are one: each key points to the one it joined
    joined = {}

    def find(key):
        while key in joined:
            key = joined[key]
        return key

    for path, digest in zip(paths, digests, strict=True):
        first, second = find(named.get(path, digest)), find(digest)
        if first != second:
            joined[second] = first
    return [find(digest) for digest in digests]
