"""Files that are either the old ones or the new ones whole, never a torn half."""

import os
from pathlib import Path


def write_bytes(path: str | os.PathLike, data: bytes) -> Path:
    """Write a file under a temporary name beside it, then put it in place at once.

    Folders on the way are made. A writer that is killed leaves the old file untouched.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def write_text(path: str | os.PathLike, text: str) -> Path:
    """``write_bytes`` of text in UTF-8."""
    return write_bytes(path, text.encode("utf-8"))
