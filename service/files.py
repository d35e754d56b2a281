"""Text files of users that are read, and files that are written."""

import codecs
import contextlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any


class FileError(ValueError):
    """A file that cannot be written; the text is one line for the user."""


class EncodingError(ValueError):
    """A text that is not in UTF-8; one line for the user."""


def utf8_of(raw: bytes) -> str:
    """Decode a text that a person wrote, with or without a byte order mark.

    Raises `EncodingError` if it is in another encoding.
    """
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise EncodingError("in UTF-16; expected a file in UTF-8")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise EncodingError(
            f"line {line}: byte 0x{raw[error.start]:02x} is not UTF-8; expected a file in UTF-8"
        ) from error


@contextmanager
def replacing(path: Path, *, binary: bool = False, private: bool = False) -> Iterator[IO[Any]]:
    """Write a file next to its place, and move it there when it is complete and on the disk.

    Parameters
    ----------
    path
        Its place.
    binary
        Takes bytes instead of text, which is written in UTF-8.
    private
        Only the owner may read it.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    encoding, newline = (None, None) if binary else ("utf-8", "")
    try:
        with new_part(path, 0o600 if private else 0o666) as part:
            with open(
                part,
                "wb" if binary else "w",
                encoding=encoding,
                newline=newline,
                opener=_open_no_link,
            ) as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            part.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        raise FileError(f"{path}: cannot be written ({error.strerror})") from error


@contextmanager
def new_part(path: Path, mode: int = 0o600) -> Iterator[Path]:
    """Make an empty file next to a place, to be filled and moved there; removed otherwise.

    What has its name already, such as a link that someone planted, goes and is not followed. Raises
    `OSError` if the file cannot be made.
    """
    part = path.with_name(f"{path.name}.part")
    part.unlink(missing_ok=True)
    os.close(_open_no_link(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode))
    try:
        yield part
    finally:
        part.unlink(missing_ok=True)


def why_not_written(path: Path) -> str | None:
    """Try whether a file can be put in its place: nothing is left there; None where it can."""
    place = path.resolve()
    if os.path.ismount(place):
        return f"{place} is a mount of its own; expected the folder that it lies in to be mounted"
    try:
        with tempfile.TemporaryFile(dir=place.parent):
            return None
    except OSError as error:
        return f"the service cannot write into {place.parent} ({error.strerror})"


def make_private_folder(path: Path) -> None:
    """Make a folder, and those above it, for its owner alone; one that is there stays as it is."""
    path.mkdir(mode=0o700, parents=True, exist_ok=True)


def make_private_file(path: Path) -> None:
    """Make a file, empty when it is new, that only its owner may read.

    Where that is not ours to say nothing changes: who opens the file finds out. A file that is
    there is not opened: closing it would drop the locks that SQLite holds on it in this process.
    """
    with contextlib.suppress(OSError):
        if path.exists():
            if path.is_file():
                path.chmod(0o600)
        else:
            os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))


def _open_no_link(path: str | Path, flags: int, mode: int = 0o666) -> int:
    return os.open(path, flags | os.O_NOFOLLOW, mode)


def _sync_folder(path: Path) -> None:
    """Have the disk note a file's new name."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
