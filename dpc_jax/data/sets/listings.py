"""The models of the sets that users have on disk, and their splits.

ShapeNet trees and the published renders have official splits; where the user has none
of their files, and for own images, the split is seeded.
"""

from pathlib import Path
from typing import NamedTuple

from dpc_jax.data.sets import image_folder, released_renders, shapenet, split_lists

FEWEST_OBJECTS = 3  # of own images, to split


class Catalog(NamedTuple):
    """Models of a set by name, and how they are split.

    models: {name: path of its file or folder}. sides: {split: names}. synset: eight
    digits, or "" for own images. official: the split file that was read, or None.
    truths: folder of published ground truth, or None.
    """

    models: dict
    sides: dict
    synset: str
    official: Path | None
    truths: Path | None


def open_catalog(spec, *, split_files):
    """Lists a set on disk.

    Args:
      spec: `DataSpec` of kind "shapenet", "renders" or "images".
      split_files: the seeded split, `sources.split_files`.

    Raises:
      ValueError: naming the folder or file that is not as expected.
    """
    synset, official, truths = "", spec.split_file, None
    if spec.kind == "images":
        models = image_folder.list_objects(spec.folder)
        posed = [name for name, path in models.items() if image_folder.has_poses(path)]
        if posed and len(posed) < len(models):
            lacking = next(path for n, path in models.items() if n not in set(posed))
            raise ValueError(
                f"expected poses for all objects of {spec.folder} or for none, "
                f"{models[posed[0]]} has a pose file and {lacking} has not; add or "
                "remove."
            )
    else:
        synset, place = shapenet.find_synset(spec.folder, spec.category)
        official = official or split_lists.find_split(spec.folder, synset)
        if spec.kind == "shapenet":
            models = shapenet.list_models(place)
        else:
            models = released_renders.list_models(place)
            truths = released_renders.find_ground_truth(
                spec.folder, synset, spec.ground_truth
            )
    if official:
        sides = split_lists.read_split(official, synset)
        known = set().union(*sides.values())
        if not known & models.keys():
            raise ValueError(
                f"expected models of {spec.folder} in {official}, none of its "
                f"{len(known)} is there; give the split file of this set."
            )
        for name in known - models.keys():  # to be counted as damaged
            models[name] = place / name / shapenet.LAYOUTS[1]
            if spec.kind == "renders":
                models[name] = place / name
    elif spec.kind == "images" and len(models) < FEWEST_OBJECTS:
        sides = dict.fromkeys(split_lists.SPLITS, list(models))
    else:
        parts = split_files(list(models), fractions=spec.fractions, seed=spec.seed)
        sides = dict(zip(split_lists.SPLITS, parts, strict=True))
    return Catalog(models, sides, synset, official and Path(official), truths)


def describe_models(spec, catalog):
    """(name, path, views, key) of the models of a set's split, in order.

    Raises:
      ValueError: if the split has none.
    """
    names = catalog.sides[spec.split]
    if not names:
        raise ValueError(
            f"expected models for the {spec.split} split of {spec.folder}, got none of "
            f"{len(catalog.models)}; add models or change the split."
        )
    described = []
    for name in names:
        path = catalog.models[name]
        views = spec.views
        if spec.kind == "images":
            views, key = image_folder.describe_object(path)
        elif spec.kind == "renders":
            truth = find_truth(spec, catalog.truths, name)
            key = released_renders.describe_model(path, truth, views=views)
        else:
            key = shapenet.describe_file(path)
        described.append((name, str(path), views, key))
    return described


def find_truth(spec, truths, name):
    """Ground truth file of a published render; there is none to train on."""
    if truths is None or spec.split == "train":
        return None
    return Path(truths) / f"{name}.mat"


def list_remarks(spec, catalog):
    """What is to be said of a set as a whole, as (name, remark) pairs."""
    remarks = []
    if catalog.official:
        listed = set().union(*catalog.sides.values())
        if unlisted := len(catalog.models.keys() - listed):
            remarks.append(
                (str(catalog.official), f"leaves out {unlisted} models of the folder")
            )
    elif spec.kind == "images" and len(catalog.models) < FEWEST_OBJECTS:
        remarks.append(
            (str(spec.folder), "has too few objects to split: all splits hold them all")
        )
    return remarks
