"""DBC files that the page uploads: next to the configuration file, bounded, none overwritten."""

from pathlib import Path
from typing import Final

from service.files import FileError, replacing

DBC_FILES_MAX: Final = 100
DBC_BYTES_MAX: Final = 64 * 2**20


def place_dbc(folder: Path, name: str, text: str) -> str:
    """Write a file with `.part` behind its name; gives the name, with a number if it is taken.

    Raises `FileError` if there is no room for it.
    """
    stem = name.removesuffix(".dbc")
    number, free = 1, name
    while (folder / free).exists() and _differs(folder / free, text):
        number += 1
        free = f"{stem}-{number}.dbc"
    sizes = [one.stat().st_size for one in folder.glob("*.dbc")]
    is_full = len(sizes) >= DBC_FILES_MAX or sum(sizes) + len(text.encode()) > DBC_BYTES_MAX
    if is_full and not (folder / free).exists():
        raise FileError(
            f"{folder} holds {len(sizes)} DBC files of {sum(sizes) / 2**20:.1f} MiB; expected at "
            f"most {DBC_FILES_MAX} of {DBC_BYTES_MAX // 2**20} MiB: remove those that no source "
            "names"
        )
    with replacing(folder / f"{free}.part") as part:
        part.write(text)
    return free


def _differs(file: Path, text: str) -> bool:
    content = text.encode()
    return file.stat().st_size != len(content) or file.read_bytes() != content
