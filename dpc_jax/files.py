"""Files that are either the old ones or the new ones whole, never a torn half."""

import contextlib
import errno
import fcntl
import hashlib
import json
import math
import os
import secrets
import socket
import stat
from collections.abc import Iterable, Iterator
from io import BufferedReader
from pathlib import Path
from typing import Any

TEMPORARY = ".tmp"  # ends the names of files that are being written
# Formats of surfaces, and how the names of their files end.
SURFACES = {"glb": ".glb", "ply": "-surface.ply", "obj": ".obj"}
MOST_TEXT = 64 << 20  # bytes of a text or JSON file; those read are far smaller


class Damage(ValueError):
    """A phrase saying what is wrong inside a file, for the error that names the file.

    It never reaches the user by itself.
    """


@contextlib.contextmanager
def reading(
    what: str, path: str | os.PathLike, cure: str = "repair or remove it"
) -> Iterator[None]:
    """Say in a sentence where a file cannot be used, and what to do then.

    Raises:
      ValueError: instead of whatever a reader raises on a damaged file.
    """
    try:
        yield
    except Exception as error:
        known = isinstance(error, ValueError | OSError)
        kind = "" if known else f"{type(error).__name__}: "
        raise ValueError(
            f"Expected {what} in {path}, but it cannot be used "
            f"({kind}{describe_error(error)}); {cure}."
        ) from None


def open_regular(path: str | os.PathLike, *, most: int | None = None) -> BufferedReader:
    """Open a file that a user names, to read: a regular one of at most `most` bytes.

    A pipe would keep its reader waiting, and a device has no end.

    Raises:
      OSError: where it cannot be opened, is another kind of file, or is larger.
    """
    file = open(path, "rb", opener=lambda p, flags: os.open(p, flags | os.O_NONBLOCK))
    status = os.fstat(file.fileno())
    if not stat.S_ISREG(status.st_mode):
        file.close()
        raise OSError(
            f"Expected a regular file in {path}, but it is a pipe, a device or the "
            "like; give another file."
        )
    if most is not None and status.st_size > most:
        file.close()
        raise OSError(
            f"Expected at most {most:,} bytes in {path}, but it has "
            f"{status.st_size:,}; give another file."
        )
    return file


def read_bytes(path: str | os.PathLike, *, most: int) -> bytes:
    """Content of a file that `open_regular` opens."""
    with open_regular(path, most=most) as file:
        return file.read(most)


def read_text(path: str | os.PathLike) -> str:
    """Text in UTF-8 of at most `MOST_TEXT` bytes."""
    return read_bytes(path, most=MOST_TEXT).decode("utf-8")


def read_json(path: str | os.PathLike) -> Any:
    """JSON of at most `MOST_TEXT` bytes.

    Raises:
      ValueError: with a phrase, where it is not JSON or nested too deep to be read.
      OSError: as `open_regular`.
    """
    try:
        return json.loads(read_text(path))
    except RecursionError:
        raise ValueError("it is nested too deep") from None


@contextlib.contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """Yield a temporary path beside a file, which takes the file's place at the end.

    Folders on the way are made. A writer that fails or is killed leaves the old file
    untouched; what it wrote is removed, after a kill by `remove_leftovers`.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(
        f".{socket.gethostname()}.{os.getpid()}.{secrets.token_hex(8)}{TEMPORARY}"
    )
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def remove_leftovers(folder: str | os.PathLike):
    """Remove temporary files of this process, and of killed ones on this machine.

    The folder may be shared with other machines, whose processes nobody here can see.
    """
    for path in Path(folder).glob(f".{socket.gethostname()}.*{TEMPORARY}"):
        process = path.name.split(".")[-3]
        if process.isdigit() and not _is_another_at_work(int(process)):
            path.unlink(missing_ok=True)


def _is_another_at_work(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # it runs, but belongs to somebody else
        return True
    return process != os.getpid()


@contextlib.contextmanager
def claiming(path: str | os.PathLike) -> Iterator[bool]:
    """Yield whether this process alone may make a file, for as long as the context.

    Whether the file is there is the caller's to look at, once the claim is held. A
    claim is a lock of the kernel on the file `locate_claim`, which says whose it is: it
    ends with its process, also after kill -9, so that another one can take over. Over
    NFS such locks hold between hosts (Linux has the server keep them). Some parallel
    file systems keep them within a host, or know none: two hosts may then make a file
    twice, which costs time and nothing else as long as they make the same bytes and
    replace the file whole.
    """
    lock = locate_claim(path)
    file = _lock(lock)
    if file is None:
        yield False
        return
    try:
        os.ftruncate(file, 0)
        os.write(file, f"{os.getpid()} on {socket.gethostname()}".encode())
        yield True
    finally:
        lock.unlink(missing_ok=True)
        os.close(file)


def locate_claim(path: str | os.PathLike) -> Path:
    """The file beside a claimed one, with the process and the host that hold it."""
    path = Path(path)
    return path.with_name(f".{path.name}.claim")


def _lock(path: Path) -> int | None:
    """The open and locked file; None where another process holds the lock."""
    path.parent.mkdir(parents=True, exist_ok=True)
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            return None
        except OSError:  # no locks here: everybody may
            return file
        # The holder before may have removed what was opened here: a lock on that
        # keeps nobody out.
        with contextlib.suppress(FileNotFoundError):
            if os.stat(path).st_ino == os.fstat(file).st_ino:
                return file
        os.close(file)


@contextlib.contextmanager
def explaining_full_disk(folder: str | os.PathLike) -> Iterator[None]:
    """Say in a sentence where the disk of a folder is full, whatever failed for it.

    Raises:
      OSError: instead of the error, of whatever type, that the full disk caused.
    """
    try:
        yield
    except Exception as error:
        if not is_disk_full(error):
            raise
        raise OSError(
            f"The disk of {Path(folder).absolute()} must have room to write to, but "
            "the disk is full; free some and give the same command again. It goes on "
            "from what is there: nothing that was whole is lost."
        ) from None


def describe_error(error: BaseException) -> str:
    """What went wrong without the path, for sentences that name the file themselves."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error).rstrip(".")


def is_disk_full(error: BaseException | None) -> bool:
    """Whether a full disk or a used-up quota caused an error, or one that it is from.

    Libraries tell it by text, too: those written in C++ have no OSError.
    """
    numbers = (errno.ENOSPC, errno.EDQUOT)
    texts = [os.strerror(number) for number in numbers]
    while error is not None:
        if isinstance(error, OSError) and error.errno in numbers:
            return True
        if any(text in str(error) for text in texts):
            return True
        # An error that was put into other words stands for itself.
        hidden = error.__suppress_context__ and error.__cause__ is None
        error = None if hidden else error.__cause__ or error.__context__
    return False


def write_bytes(path: str | os.PathLike, data: bytes) -> Path:
    """Write a file so that it is either the old one or the new one whole."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)
    return Path(path)


def write_text(path: str | os.PathLike, text: str) -> Path:
    """`write_bytes` of text in UTF-8."""
    return write_bytes(path, text.encode("utf-8"))


def write_json(path: str | os.PathLike, data: Any) -> Path:
    """`write_text` of JSON; a number that is not finite becomes null."""
    text = json.dumps(_make_plain(data), indent=1, ensure_ascii=False)
    return write_text(path, text + "\n")


def digest_file(path: str | os.PathLike) -> str:
    """SHA-256 of a file's content, in hexadecimal digits."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest_text(text: str) -> str:
    """SHA-256 of a text in UTF-8, in hexadecimal digits; of any file name, too."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def list_sizes(paths: Iterable[Path]) -> list[int]:
    """Sizes of files in bytes, -1 for one that is not there."""
    return [path.stat().st_size if path.is_file() else -1 for path in paths]


def _make_plain(value):
    if isinstance(value, dict):
        return {str(key): _make_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_make_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
