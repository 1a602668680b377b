"""Variants of one design among the models of a folder, which no split may part."""

import json


def group_variants(paths, digests):
    """One key per file; files of equal content or of one family have the same.

    Families are read from the `families.json` of the folder that a file lies in, which
    maps file names to families; without, only equal files belong together.

    Raises:
      ValueError: naming the file, if a `families.json` is none.
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
                f"expected names of files with their families in {listed}, it cannot "
                f"be read ({error}); repair or remove it."
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
