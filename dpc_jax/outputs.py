"""What commands write and say: files of their own, and text that can be shown.

A command never writes over a file that no command has written. What they wrote is
listed in the folder, by name with the SHA-256 of the content, so that a file which
somebody has changed or put there is told from theirs.
"""

import contextlib
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from dpc_jax.files import digest_file, read_json, write_json

LIST = ".dpc_jax-wrote.json"


@contextlib.contextmanager
def owning(
    folder: str | os.PathLike, names: Sequence[str], *, inputs: Iterable[Path] = ()
) -> Iterator[None]:
    """Refuse outputs that would take the place of a file of somebody else.

    What is there under their names at the end is listed. A command that is killed
    leaves them listed without content, and the next one goes on.

    Args:
      folder: of the outputs.
      names: of files in it; of folders in it with / at the end.
      inputs: files that are read, which are never written.

    Raises:
      ValueError: for a file of somebody else, an input, or a name that comes twice.
      OSError: where a name is too long, or the folder cannot be written.
    """
    if not names:
        yield
        return
    folder, inputs = Path(folder), list(inputs)
    missing = [p for p in (folder, *folder.parents) if not os.path.lexists(p)]
    try:
        with trying_to_write(folder):
            folder.mkdir(parents=True, exist_ok=True)
        written = _read_list(folder)
        for number, name in enumerate(names):
            if name in names[:number]:
                raise ValueError(
                    f"Expected outputs of different names, but {folder / name} would "
                    "be written twice; rename the input, or give several one by one, "
                    "each with an --out of its own."
                )
            _refuse_others(folder / name, name, written, inputs)
        with trying_to_write(folder):
            write_json(folder / LIST, written | dict.fromkeys(names, ""))
        try:
            yield
        finally:
            _list_written(folder, names)
    finally:
        for path in missing:
            with contextlib.suppress(OSError):  # what is not empty stays
                path.rmdir()


@contextlib.contextmanager
def trying_to_write(folder: Path, flag: str = "--out") -> Iterator[None]:
    """Say in a sentence where a folder cannot be made or written, and the flag."""
    try:
        yield
    except OSError as error:
        if error.strerror is None:  # it is a sentence
            raise
        reason = "it is a file" if os.path.isfile(folder) else error.strerror
        raise OSError(
            f"Expected to write in the folder {folder}, but it cannot be made or "
            f"written ({reason}); give another {flag}."
        ) from None


def _list_written(folder: Path, names: Sequence[str]):
    """Put what is there into the list, to which another command may have added."""
    found = _read_list(folder)
    for name in names:
        found.pop(name, None)
        path = folder / name
        if path.exists():
            found[name] = "" if path.is_dir() else digest_file(path)
    if found:
        write_json(folder / LIST, found)
    else:
        (folder / LIST).unlink(missing_ok=True)


def _refuse_others(path: Path, name: str, written: dict, inputs: list[Path]):
    try:
        path.lstat()
    except FileNotFoundError:
        return
    except OSError as error:
        raise OSError(
            f"Expected to write {path}, but there can be no such file "
            f"({error.strerror}); rename the input, or give another --out."
        ) from None
    if any(one.exists() and path.exists() and one.samefile(path) for one in inputs):
        reason = "it is an input"
    elif name not in written or path.is_symlink():
        reason = "what is there was not written by a command"
    elif path.is_dir() if name.endswith("/") else _is_unchanged(path, written[name]):
        reason = ""
    else:
        reason = "what is there has been changed since a command wrote it"
    if reason:
        raise ValueError(
            f"Expected to write {path}, but {reason}; move it, or give another --out."
        )


def _is_unchanged(path: Path, digest: str) -> bool:
    """Whether a file is as written; one whose writer was killed has no digest."""
    return path.is_file() and digest in ("", digest_file(path))


def _read_list(folder: Path) -> dict[str, str]:
    """Digests by name; a list that cannot be read is none, so that all is refused."""
    with contextlib.suppress(OSError, ValueError):
        found = read_json(folder / LIST)
        if isinstance(found, dict):
            return {str(n): d for n, d in found.items() if isinstance(d, str)}
    return {}


def show_text(text: object) -> str:
    """A text as any terminal, file and figure can show it, in one line.

    Names of files may hold bytes that are no UTF-8, line breaks, and codes that move
    the cursor of a terminal or turn the direction of writing: those become �.
    """
    return "".join(
        c if c.isprintable() else " " if c.isspace() else "\N{REPLACEMENT CHARACTER}"
        for c in str(text)
    )


def telling_tenths(title: str) -> Callable[[str, int, int], None]:
    """A function (part, done, total) that prints a line for every tenth of a part."""
    started, told = time.monotonic(), {}

    def tell(part, done, total):
        tenth = 10 * done // max(total, 1)
        if tenth > told.get(part, -1):
            told[part] = tenth
            seconds = time.monotonic() - started
            print(f"{title}: {part}, {done}/{total}, {seconds:.0f} s", flush=True)

    return tell


# Of a library, where it is not in `learn` alone.
EXTRAS = {"viser": "learn,view", "tensorboardX": "learn,tensorboard"}


def explain(error: Exception) -> str:
    """An error that ends a command, in one line; the system's own as a sentence."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return show_text(
            f"{error.filename} cannot be read or written ({error.strerror}); make "
            "room, or give another path."
        )
    if isinstance(error, ModuleNotFoundError):
        extras = EXTRAS.get(str(error.name), "learn")
        return (
            f"{error.name} must be installed, but it is not there; activate the "
            "environment that has it (. .venv/bin/activate), or install what the "
            f"command needs: pip install 'dpc_jax[{extras}]'."
        )
    return show_text(error)
