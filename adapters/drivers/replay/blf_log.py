"""BLF logs that were cut or damaged: python-can's reader takes their ends without a word."""

from collections.abc import Iterator
from pathlib import Path

import can
from can.io.blf import BLFParseError

_SIGNATURE = b"LOBJ"
_HEAD_BYTES = 16
_SIZE = slice(8, 12)
_PADDING_BYTES = 3


class CheckedBlfReader(can.BLFReader):
    """Reads a log; an object that is shorter than its own head is an error and no endless loop."""

    def _parse_data(self, data: bytes) -> Iterator[can.Message]:
        place = data.find(_SIGNATURE, 0, 8)
        while 0 <= place <= len(data) - _HEAD_BYTES:
            size = _size(data[place : place + _HEAD_BYTES])
            if size < _HEAD_BYTES:
                raise BLFParseError(f"an object of {size} bytes")
            place = data.find(_SIGNATURE, place + size, place + size + 8)
        yield from super()._parse_data(data)


def has_ended(path: Path, log: can.BLFReader) -> bool:
    """Whether the reader failed at padding, and nothing else follows the last whole object."""
    place, _ = _end_of_objects(path)
    if log.file.tell() <= place:
        return False
    with path.open("rb") as file:
        file.seek(place)
        return not any(any(block) for block in iter(lambda: file.read(65536), b""))


def is_cut(path: Path, log: can.BLFReader) -> bool:
    """Whether the last object of a log is not there as a whole, or less than its head says."""
    _, is_whole = _end_of_objects(path)
    rest = any(log._tail)  # of an object that goes on in a container which is not there
    return not is_whole or rest or path.stat().st_size + _PADDING_BYTES < log.file_size


def _end_of_objects(path: Path) -> tuple[int, bool]:
    """Where the last whole object ends, and whether no other one begins there."""
    end = path.stat().st_size
    with path.open("rb") as file:
        place = int.from_bytes(file.read(8)[4:], "little")
        while 0 < place < end:
            file.seek(place)
            head = file.read(_HEAD_BYTES)
            size = _size(head)
            if head[:4] != _SIGNATURE[: len(head)]:
                break
            if size < _HEAD_BYTES or place + size > end:
                return place, False
            place += size + size % 4
    return min(place, end), True


def _size(head: bytes) -> int:
    return int.from_bytes(head[_SIZE], "little")
