"""What an OBJ file lacks of the materials and textures that it names."""

import contextlib
import re
from pathlib import Path

from dpc_jax import files
from dpc_jax.data.meshes import decode_text, find_beside
from dpc_jax.data.sets import pictures

BARE = "names no materials, rendered grey"


def describe_flaw(path: str | Path) -> str | None:
    """What an OBJ file lacks of materials and textures, or None for nothing.

    The model is rendered all the same, in the plain colours of its materials or in
    grey. A texture that is no readable picture counts as missing.
    """
    path = Path(path)
    with files.open_regular(path) as file:
        head = file.read(1 << 20)  # materials are named before anything uses them
    text = head.decode("utf-8", errors="replace")
    libraries = re.findall(r"^mtllib[ \t]+(.+?)\s*$", text, re.MULTILINE)
    if not libraries:
        return BARE
    content = _read_materials(path, libraries)
    if content is None:
        return f"lacks its materials {libraries[0]}, rendered grey"
    if not re.search(r"^\s*newmtl[ \t]+\S", content, re.MULTILINE):
        return f"has no material in {libraries[0]}, rendered grey"
    images = re.findall(r"^\s*map_Kd[ \t]+(.+?)\s*$", content, re.MULTILINE)
    lost = [
        name
        for name in images
        if not (place := find_beside(path, name)) or not pictures.is_readable(place)
    ]
    if lost:
        return f"lacks {len(lost)} of {len(images)} textures, {lost[0]} for one"
    return None


def _read_materials(path, libraries):
    """Text of all material files that can be read; None where there is none."""
    found = []
    for name in libraries:
        if place := find_beside(path, name):
            with contextlib.suppress(OSError):
                found.append(files.read_bytes(place, most=files.MOST_TEXT))
    return "\n".join(map(decode_text, found)) if found else None
