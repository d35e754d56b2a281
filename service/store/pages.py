"""Rows of an SQLite file page by page, past its trees: what is left of a damaged file.

SQLite finds rows from the root of each tree downwards, and gives up at a damaged page although
the pages below are whole. Here every page is read for itself, as its file format describes it
(https://www.sqlite.org/fileformat2.html); a page that makes no sense gives no rows.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

Value = int | float | str | bytes | None

_HEADER_BYTES = 100
_DEFAULT_PAGE_BYTES = 4096
_TABLE_LEAF, _INDEX_LEAF, _INDEX_INNER = 0x0D, 0x0A, 0x02
#: Frames of a write-ahead log begin with a header of their own; so does the log.
_LOG_HEADER_BYTES, _FRAME_HEADER_BYTES = 32, 24
_INTEGER_BYTES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}


class PageRow(NamedTuple):
    """One row; `rowid` is None for a table without row numbers, or an index."""

    rowid: int | None
    values: tuple[Value, ...]


class _Pages:
    """The pages of a file that can be read, by their numbers from 1."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        header = self._bytes(0, _HEADER_BYTES)
        size = int.from_bytes(header[16:18], "big")
        size = 65536 if size == 1 else size
        known = header.startswith(b"SQLite format 3\0") and size.bit_count() == 1 and size >= 512
        self.page_bytes = size if known else _DEFAULT_PAGE_BYTES
        self.usable = self.page_bytes - (header[20] if known and header[20] <= 32 else 0)
        self.count = -(-file.seek(0, 2) // self.page_bytes)
        self._first_free = int.from_bytes(header[32:36], "big") if known else 0

    def page(self, number: int) -> bytes:
        """Give a page; shorter, or empty, where the disk does not give it."""
        return self._bytes((number - 1) * self.page_bytes, self.page_bytes)

    def free(self) -> set[int]:
        """Numbers of the pages that are not in use, as far as their list can be read."""
        found: set[int] = set()
        trunk = self._first_free
        while 0 < trunk <= self.count and trunk not in found:
            found.add(trunk)
            page = self.page(trunk)
            following, length = struct.unpack(">II", page[:8]) if len(page) >= 8 else (0, 0)
            entries = page[8 : 8 + 4 * min(length, self.usable // 4 - 2)]
            found.update(
                number for (number,) in struct.iter_unpack(">I", entries[: len(entries) // 4 * 4])
            )
            trunk = following
        return found

    def _bytes(self, offset: int, count: int) -> bytes:
        try:
            self._file.seek(offset)
            return self._file.read(count)
        except OSError:  # a sector that cannot be read
            return b""


def page_rows(path: Path) -> Iterator[PageRow]:
    """Read all rows of all pages of a file that are not on its list of free ones.

    Rows of all tables and indexes come mixed; the caller sorts them by their shape. Raises
    `OSError` if the file cannot be opened.
    """
    with path.open("rb", buffering=0) as raw:
        pages = _Pages(raw)
        free = pages.free()
        for number in range(1, pages.count + 1):
            if number not in free:
                begin = _HEADER_BYTES if number == 1 else 0
                yield from _rows(pages, pages.page(number), begin)


def log_rows(path: Path) -> Iterator[PageRow]:
    """Read all rows of the pages in a write-ahead log, the newest pages first.

    Raises `OSError` if the file cannot be opened.
    """
    with path.open("rb", buffering=0) as raw:
        pages = _Pages(raw)
        frame_bytes = _FRAME_HEADER_BYTES + pages.page_bytes
        count = (raw.seek(0, 2) - _LOG_HEADER_BYTES) // frame_bytes
        for frame in range(count - 1, -1, -1):
            try:
                raw.seek(_LOG_HEADER_BYTES + frame * frame_bytes)
                content = raw.read(frame_bytes)
            except OSError:
                continue
            first = content[:4] == b"\x00\x00\x00\x01"
            yield from _rows(pages, content[_FRAME_HEADER_BYTES:], _HEADER_BYTES if first else 0)


def _rows(pages: _Pages, page: bytes, begin: int) -> Iterator[PageRow]:
    if len(page) < begin + 8 or page[begin] not in (_TABLE_LEAF, _INDEX_LEAF, _INDEX_INNER):
        return
    kind = page[begin]
    count = int.from_bytes(page[begin + 3 : begin + 5], "big")
    first = begin + (12 if kind == _INDEX_INNER else 8)
    pointers = page[first : min(first + 2 * count, len(page) // 2 * 2)]
    for place in range(0, len(pointers) - 1, 2):
        at = int.from_bytes(pointers[place : place + 2], "big")
        try:
            yield _cell(pages, page, kind, at)
        except (ValueError, IndexError, struct.error):
            continue


def _cell(pages: _Pages, page: bytes, kind: int, at: int) -> PageRow:
    rowid = None
    if kind == _INDEX_INNER:
        at += 4  # the page below
    size, at = _varint(page, at)
    if kind == _TABLE_LEAF:
        number, at = _varint(page, at)
        rowid = number - (1 << 64) if number >= 1 << 63 else number
    usable = pages.usable
    most = usable - 35 if kind == _TABLE_LEAF else (usable - 12) * 64 // 255 - 23
    least = (usable - 12) * 32 // 255 - 23
    if size <= most:
        local = size
    else:
        local = least + (size - least) % (usable - 4)
        local = local if local <= most else least
    payload = page[at : at + local]
    if size > local:
        payload += _overflow(
            pages, int.from_bytes(page[at + local : at + local + 4], "big"), size - local
        )
    if len(payload) != size:
        raise ValueError("torn")
    return PageRow(rowid, _record(payload))


def _overflow(pages: _Pages, number: int, size: int) -> bytes:
    parts: list[bytes] = []
    while size > 0:
        if not 0 < number <= pages.count:
            raise ValueError("torn")
        page = pages.page(number)
        number = int.from_bytes(page[:4], "big")
        part = page[4 : min(4 + size, pages.usable)]
        if not part:
            raise ValueError("torn")
        parts.append(part)
        size -= len(part)
    return b"".join(parts)


def _record(payload: bytes) -> tuple[Value, ...]:
    header_bytes, at = _varint(payload, 0)
    if not 0 < header_bytes <= len(payload):
        raise ValueError("torn")
    values: list[Value] = []
    body = header_bytes
    while at < header_bytes:
        kind, at = _varint(payload, at)
        value, body = _value(payload, body, kind)
        values.append(value)
    if at != header_bytes or body != len(payload):
        raise ValueError("torn")
    return tuple(values)


def _value(payload: bytes, at: int, kind: int) -> tuple[Value, int]:
    if kind == 0:
        return None, at
    if kind in (8, 9):
        return kind - 8, at
    if kind == 7:
        return struct.unpack(">d", payload[at : at + 8])[0], at + 8
    if kind in _INTEGER_BYTES:
        end = at + _INTEGER_BYTES[kind]
        return int.from_bytes(payload[at:end], "big", signed=True), end
    if kind < 12:
        raise ValueError("no such kind of value")
    end = at + (kind - 12) // 2
    content = payload[at:end]
    return (content if kind % 2 == 0 else content.decode("utf-8")), end


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for _ in range(8):
        byte = data[at]
        at += 1
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at
    return value << 8 | data[at], at + 1
