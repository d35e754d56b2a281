"""The configuration file as it was: each version that was saved, by whom and when.

A version is a file of its own in the data directory, so that an undo needs no database, and a
text editor can read it.
"""

import hashlib
import json
import stat
import threading
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from service.domain.errors import BearingTwinError
from service.files import make_private_folder, replacing, utf8_of

FOLDER: Final = "configurations"
#: Older versions are removed.
VERSIONS_MAX: Final = 200
BYTES_MAX: Final = 32 * 2**20
BY_HAND: Final = "by hand"
#: One change at a time: of two that are based on the same text, the second is refused.
_turn = threading.Lock()


@dataclass(frozen=True, slots=True)
class FileVersion:
    """One version of the configuration file.

    - ``saved_us``: wall time; of one that was written by hand, when it was first seen.
    - ``who``: as in the audit trail, or ``by hand``.
    """

    number: int
    saved_us: int
    who: str
    what: str
    text: str

    @property
    def revision(self) -> str:
        """Names the text."""
        return revision_of(self.text)


class FileChangedError(BearingTwinError, ValueError):
    """Somebody else has changed the file since it was read."""


def revision_of(text: str) -> str:
    """Name a text; equal texts have the same name."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_file(file: Path) -> str:
    """Read a configuration file; one that is not there yet is empty."""
    try:
        return utf8_of(file.read_bytes()).replace("\r\n", "\n")
    except FileNotFoundError:
        return ""


def versions(data_dir: Path) -> list[FileVersion]:
    """List all versions, newest first."""
    folder = data_dir / FOLDER
    found = [_read(path) for path in folder.glob("*.json")] if folder.is_dir() else []
    return sorted(found, key=lambda one: -one.number)


def save(
    file: Path, data_dir: Path, text: str, *, based_on: str, who: str, what: str, now_us: int
) -> FileVersion | None:
    """Put a text into the place of a configuration file, whole or not at all, and keep it.

    What was written by hand before is kept as a version of its own, so that it can be had back.
    Where nothing changes it writes nothing and returns None. Raises `FileChangedError` if the file
    no longer holds what the change is based on; `FileError` if a file cannot be written.
    """
    with _turn:
        return _save(file.resolve(), data_dir, text, based_on, who, what, now_us)


def _save(
    place: Path, data_dir: Path, text: str, based_on: str, who: str, what: str, now_us: int
) -> FileVersion | None:
    before = read_file(place)
    if revision_of(before) != based_on:
        raise FileChangedError("the configuration file has been changed meanwhile; read it again")
    if before == text:
        return None
    known = versions(data_dir)
    number = known[0].number if known else 0
    if not known or known[0].text != before:
        number += 1
        _keep(data_dir, FileVersion(number, now_us, BY_HAND, "the file as it was found", before))
    version = FileVersion(number + 1, now_us, who, what, text)
    # First the history: a version that never came into effect differs from its successor.
    _keep(data_dir, version)
    _prune(data_dir, number + 1)
    private = not place.exists() or not stat.S_IMODE(place.stat().st_mode) & 0o077
    with replacing(place, private=private) as part:
        part.write(text)
    return version


def _keep(data_dir: Path, version: FileVersion) -> None:
    folder = data_dir / FOLDER
    make_private_folder(folder)
    with replacing(folder / f"{version.number:06d}.json", private=True) as part:
        json.dump(asdict(version), part, ensure_ascii=False)


def _prune(data_dir: Path, newest: int) -> None:
    """Remove the oldest versions beyond the bounds; the last two always stay."""
    room = BYTES_MAX
    for path in sorted((data_dir / FOLDER).glob("*.json"), reverse=True):
        number = int(path.stem) if path.stem.isdecimal() else newest
        room -= path.stat().st_size
        if number <= newest - 2 and (number <= newest - VERSIONS_MAX or room < 0):
            path.unlink(missing_ok=True)


def _read(path: Path) -> FileVersion:
    return FileVersion(**json.loads(path.read_text(encoding="utf-8")))
