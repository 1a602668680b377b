"""Models of open packages, and the pieces that they are joined from."""

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import trimesh

from dpc_jax.shapes.normalization import face_colors, join_pieces


class OpenModel(NamedTuple):
    """One model of a package, before its mesh is made.

    name: unique in its category. family: models of one family are variants of one
    design. side: "train", "test" or "reserved". origin: licence, author and file, for
    the JSON file beside the model. source: what the package's module needs to make it.
    """

    name: str
    family: str
    side: str
    origin: dict
    source: tuple


def extract_model(archive: Path, member: str, folder: Path) -> Path:
    """Unpack a member of a zip archive with all that lies beside it; its path."""
    beside = f"{Path(member).parent}/"
    with zipfile.ZipFile(archive) as content:
        names = [name for name in content.namelist() if name.startswith(beside)]
        content.extractall(folder, names)
    return folder / member


def join_meshes(pieces: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of several, with their face colours."""
    vertices, faces, colors = join_pieces(
        [(piece.vertices, piece.faces, face_colors(piece)) for piece in pieces]
    )
    return trimesh.Trimesh(vertices, faces, face_colors=colors, process=False)
