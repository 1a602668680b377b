"""What an OBJ file lacks of the materials and textures that it names."""

import re
from pathlib import Path

from dpc_jax.data.sets import pictures

BARE = "names no materials, rendered grey"


def describe_flaw(path: str | Path) -> str | None:
    """What an OBJ file lacks of materials and textures, or None for nothing.

    The model is rendered all the same, in the plain colours of its materials or in
    grey. A texture that is no readable picture counts as missing.
    """
    path = Path(path)
    with open(path, encoding="utf-8", errors="replace") as file:
        text = file.read(1 << 20)  # materials are named before anything uses them
    libraries = re.findall(r"^mtllib[ \t]+(.+?)\s*$", text, re.MULTILINE)
    if not libraries:
        return BARE
    found = [path.parent / name for name in libraries if (path.parent / name).is_file()]
    if not found:
        return f"lacks its materials {libraries[0]}, rendered grey"
    content = "\n".join(
        library.read_text(encoding="utf-8", errors="replace") for library in found
    )
    if not re.search(r"^\s*newmtl[ \t]+\S", content, re.MULTILINE):
        return f"has no material in {libraries[0]}, rendered grey"
    images = re.findall(r"^\s*map_Kd[ \t]+(.+?)\s*$", content, re.MULTILINE)
    lost = [
        name
        for name in images
        if not pictures.is_readable(path.parent / name.replace("\\", "/"))
    ]
    if lost:
        return f"lacks {len(lost)} of {len(images)} textures, {lost[0]} for one"
    return None
