"""Reading mesh files: find them, read them with their colours, bring them to size.

Files are expected in the canonical frame: z up, front towards +x, left towards +y.
"""

import contextlib
import io
import re
from pathlib import Path

import numpy as np
import trimesh
from trimesh.resolvers import FilePathResolver
from trimesh.visual.color import uv_to_color

from dpc_jax import files
from dpc_jax.data.sets import pictures
from dpc_jax.files import Damage, describe_error
from dpc_jax.shapes.normalization import join_pieces

SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
MOST_BYTES = 1 << 29  # of a file: a mesh of some millions of faces
_PICTURES = (*pictures.SUFFIXES, ".tga")
PLAIN = np.array([170, 170, 170, 255], dtype=np.uint8)  # where a file has no colour


def find_meshes(folder: Path) -> list[Path]:
    """Mesh files below a folder, at any depth, sorted by path."""
    found = (path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    return sorted(path for path in found if path.is_file())


def read_mesh(path: str | Path) -> trimesh.Trimesh:
    """Read a file with one of `SUFFIXES` into a single mesh with one colour per face.

    The parts of a scene are put in place by their transforms and concatenated. Colours
    come from face colours, vertex colours (mean of a face's corners), a texture (looked
    up at the middle of the face) or the material, in this order; grey without any.
    `metadata["flaw"]` of the mesh is what an OBJ file lacks of materials and textures,
    as a phrase, or "".
    """
    path = Path(path)
    try:
        content = files.read_bytes(path, most=MOST_BYTES)
        resolver = _Files(str(path))
        kind, file = path.suffix.lower()[1:], io.BytesIO(content)
        if kind == "obj":
            file = io.StringIO(decode_text(content))
        scene = trimesh.load_scene(
            file, file_type=kind, resolver=resolver, process=False
        )
        nodes = sorted(scene.graph.nodes_geometry)
        pieces = [_place_part(scene, node) for node in nodes]
    except Exception as error:  # readers raise anything at all on damaged files
        reason = f"got {type(error).__name__}: {str(error).rstrip('.')}"
        if isinstance(error, OSError):
            reason = f"it cannot be read ({describe_error(error)})"
        if getattr(error, "name", None) == "charset_normalizer":  # trimesh's last try
            reason = "it is neither text nor whole"
        raise _refuse(path, "a readable mesh", reason) from error
    pieces = [piece for piece in pieces if piece is not None]
    if not pieces:
        raise _refuse(path, "a mesh with faces", "it has none")
    vertices, faces, colors = join_pieces(pieces)
    if faces.min() < 0 or faces.max() >= len(vertices):
        between = f"faces between {len(vertices)} vertices"
        raise _refuse(path, between, "an index is out of range")
    # only vertices that have a face: a stray one would spoil the box
    index, faces = np.unique(faces, return_inverse=True)
    used, faces = vertices[index], faces.reshape(-1, 3)
    if not np.isfinite(used).all():
        raise _refuse(path, "finite coordinates", "there is NaN or infinity")
    if not np.ptp(used, axis=0).max() > 0:
        raise _refuse(path, "a mesh with an extent", "all its vertices coincide")
    flaw = ""
    # Readers give the faces of a file without colours one grey.
    is_grey = (colors == colors[0]).all() and np.ptp(colors[0, :3]) == 0
    if kind == "obj" and not resolver.asked and is_grey:
        flaw = "names no materials, rendered grey"
    elif kind == "obj" and (lost := resolver.lost):
        flaw = f"lacks {', '.join(lost[:2])}{' and more' * (len(lost) > 2)}"
    return trimesh.Trimesh(
        used, faces, face_colors=colors, process=False, metadata={"flaw": flaw}
    )


def _refuse(path, expected, found):
    return ValueError(
        f"Expected {expected} in {path}, but {found}; repair or remove it."
    )


def find_beside(mesh: Path, name: str) -> Path | None:
    """A file that a mesh file names, or None: a stranger's file may name anything.

    Regular files of the mesh's folder and the one above, where ShapeNet keeps textures,
    are looked for where they are said to be, and by name beside the mesh.
    """
    name = name.strip().replace("\\", "/")
    # A mesh that is a link may have its textures beside the file that it stands for.
    folders = [mesh.parent.resolve(), mesh.resolve().parent]
    above = [f.parent for f in folders if f.parent != f.parent.parent]  # never all
    for place in (name, name.lstrip("/"), name.rsplit("/", 1)[-1]):
        # A name may be none at all, or lead round a ring of links.
        with contextlib.suppress(OSError, ValueError, RuntimeError):
            path = (mesh.parent / place).resolve()
            near = any(path.is_relative_to(folder) for folder in (*folders, *above))
            if near and path.is_file():
                return path
    return None


class _Files(FilePathResolver):
    """Materials and textures of a mesh file, as systems of all kinds name them.

    `asked` are the names in the order of the file, `lost` those of no use.
    """

    def __init__(self, path):
        super().__init__(path)
        self.asked, self.lost = [], []

    def get(self, name):
        self.asked.append(name)
        try:
            return self._read(name)
        except (OSError, ValueError):
            self.lost.append(name)
            raise

    def _read(self, name):
        path = find_beside(Path(self.file_path), name)
        if path is None:
            raise FileNotFoundError(name)
        if path.suffix.lower() != ".mtl":
            if path.suffix.lower() in _PICTURES:
                pictures.check_picture(path)
            return files.read_bytes(path, most=MOST_BYTES)
        text = decode_text(files.read_bytes(path, most=files.MOST_TEXT))
        if not re.search(r"^\s*newmtl[ \t]+\S", text, re.MULTILINE):
            raise Damage("it has no material")
        return text.encode()


def decode_text(content: bytes) -> str:
    """Text of a file; other encodings are read too, if with wrong letters."""
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _place_part(scene, node):
    """Vertices, faces and face colours of one node of a scene, or None for no mesh."""
    transform, name = scene.graph[node]
    part = scene.geometry[name]
    if not isinstance(part, trimesh.Trimesh) or len(part.faces) == 0:
        return None
    vertices = trimesh.transform_points(part.vertices, transform)
    return vertices, np.asarray(part.faces), _face_colors(part)


def _face_colors(part):
    """Colours [F, 4] uint8 of the faces of one part."""
    count = len(part.faces)
    visual = part.visual
    if visual.kind in ("face", "vertex"):
        return np.asarray(visual.face_colors, dtype=np.uint8)
    if visual.kind == "texture":
        material = visual.material
        texture = getattr(material, "baseColorTexture", None)
        texture = getattr(material, "image", None) if texture is None else texture
        is_small = texture is not None and np.prod(texture.size) <= pictures.MOST_PIXELS
        if is_small and visual.uv is not None:
            middle = np.asarray(visual.uv)[part.faces].mean(axis=1)
            # A cut picture shows only when its pixels are asked for; Pillow raises
            # anything at all then. The plain colour remains.
            with contextlib.suppress(Exception):
                return uv_to_color(middle, texture)
        return np.tile(np.asarray(material.main_color, dtype=np.uint8), (count, 1))
    return np.tile(PLAIN, (count, 1))
