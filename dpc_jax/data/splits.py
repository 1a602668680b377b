"""Seeded splits of files, which never part the variants of one design."""

from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dpc_jax.files import describe_error, read_json

SPLITS = ("train", "val", "test")


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
      ValueError: if the fractions are not three shares with a positive sum, or there
        are fewer groups than parts.
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
    named = {}
    for place in {path.parent for path in paths}:
        listed = place / "families.json"
        if not listed.is_file():
            continue
        try:
            known = read_json(listed)
            named |= {place / name: f"family {known[name]}" for name in known}
        except (OSError, ValueError, TypeError) as error:
            raise ValueError(
                f"Expected {listed} to map file names to families, but it cannot be "
                f"read ({describe_error(error)}); repair or remove it."
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
