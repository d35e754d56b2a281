"""Samples on the disk that wait for a store which is away: bounded, in order, crash-safe."""

import math
import sqlite3
import struct
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple, Self

from adapters.samples import Sample, is_bad
from service.domain.channels import importance
from service.store import DurableQueue, Mended, QueueFile, QueueLayout, Row
from service.store.queue_file import used_pages

FILE_NAME = "spool.db"

_BYTES_PER_MIB = 2**20
#: When the spool is full, so much of it makes room at once.
_MAKE_ROOM = 0.02
_APPLICATION_ID = 0x42547370

_TABLES = """
CREATE TABLE IF NOT EXISTS samples (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    importance INTEGER NOT NULL,
    asset TEXT NOT NULL,
    channel TEXT NOT NULL,
    time_us INTEGER NOT NULL,
    value REAL,
    quality INTEGER NOT NULL,
    received_us INTEGER NOT NULL,
    checksum INTEGER
)
"""
_COLUMNS = ("importance", "asset", "channel", "time_us", "value", "quality", "received_us")
_FIXED = struct.Struct("<qqqd")


class Chunk(NamedTuple):
    """The oldest samples of the spool; `last_id` removes them when they are stored.

    `damaged` rows among them are not what was put there, and are left out.
    """

    last_id: int
    samples: list[Sample]
    damaged: int = 0


class Spool:
    """A bounded queue of samples in an SQLite file of its own.

    What was appended is on the disk when `append` returns, and stays there until `remove`. Safe to
    call from any thread. A full spool of ``size_mib`` gives up the oldest samples of the least
    important channels.
    """

    def __init__(self, queue: DurableQueue, size_mib: int) -> None:
        self._queue = queue
        self._taken_lost = 0
        with queue.file.reading() as connection:
            self._page_bytes = int(connection.execute("PRAGMA page_size").fetchone()[0])
        self._pages_max = max(size_mib * _BYTES_PER_MIB // self._page_bytes, 16)

    @classmethod
    def open(cls, folder: Path, size_mib: int) -> Self:
        """Open the spool of a data directory; samples of an earlier run are still in it.

        Raises `StoreError` if the file can be neither opened nor made; one line that names it.
        """
        return cls(DurableQueue(QueueFile.open(folder / FILE_NAME, _LAYOUT)), size_mib)

    def __len__(self) -> int:
        """Samples that wait."""
        return len(self._queue)

    @property
    def mended(self) -> Mended | None:
        """What became of the file when it was last found damaged in this run."""
        return self._queue.mended

    def take_lost(self) -> int:
        """Samples that damage of the file has cost since the last call."""
        lost = self._queue.lost - self._taken_lost
        self._taken_lost += lost
        return lost

    @property
    def size_bytes(self) -> int:
        """What the samples take on the disk."""
        with self._queue.file.reading() as connection:
            return used_pages(connection) * self._page_bytes

    def oldest_received_us(self) -> int | None:
        """Receipt time of the sample that waits longest; None when none waits.

        Raises `QueueUnavailableError` if the file cannot be read now.
        """
        with self._queue.file.reading() as connection:
            row = connection.execute(
                "SELECT received_us FROM samples ORDER BY id LIMIT 1"
            ).fetchone()
        return None if row is None else int(row[0])

    def append(self, samples: Collection[Sample]) -> int:
        """Put samples at the end; when this returns they are on the disk.

        Returns how many samples were given up to make room, the oldest of the least important
        channels. Raises `QueueUnavailableError` if the disk does not take them; then none is in the
        spool.
        """
        rows = []
        for one in samples:
            # Minus zero, which the file does not keep, becomes zero.
            value = one.value + 0.0 if math.isfinite(one.value) else None
            rank, quality = importance(one.channel), int(one.quality)
            row = (rank, one.asset, one.channel, one.time_us, value, quality, one.received_us)
            rows.append(row)
        return self._queue.append(rows, self._make_room)

    def first(self, limit: int) -> Chunk | None:
        """Read the oldest samples, in the order in which they came; None when there are none.

        Raises `QueueUnavailableError` if the file cannot be read now.
        """
        rows = self._queue.first(limit)
        if not rows:
            return None
        samples = [
            Sample(asset, channel, time_us, math.nan if value is None else value, quality, received)
            for _, asset, channel, time_us, value, quality, received in (
                row for _, row in rows if row is not None
            )
        ]
        return Chunk(rows[-1][0], samples, len(rows) - len(samples))

    def remove(self, chunk: Chunk) -> None:
        """Forget samples that are in the store now.

        Raises `QueueUnavailableError` if the disk does not take the change; they will be read, and
        stored, once more.
        """
        self._queue.remove(chunk.last_id)
        self._queue.note_damaged(chunk.damaged)

    def newest(self) -> dict[tuple[str, str], int | None]:
        """Time of the newest sample of each asset and channel; None where it is bad."""
        with self._queue.file.reading() as connection:
            rows = connection.execute(
                # SQLite gives the other columns of the row that has the maximum.
                "SELECT asset, channel, MAX(time_us), quality FROM samples GROUP BY asset, channel"
            ).fetchall()
        return {
            (asset, channel): None if is_bad(quality) else int(time_us)
            for asset, channel, time_us, quality in rows
        }

    def close(self) -> None:
        """Close the file."""
        self._queue.close()

    def _make_room(self, connection: sqlite3.Connection, count: int) -> int:
        given_up = 0
        while used_pages(connection) > self._pages_max and given_up < count:
            portion = max(int(count * _MAKE_ROOM), 1)
            given_up += connection.execute(
                "DELETE FROM samples WHERE id IN "
                "(SELECT id FROM samples ORDER BY importance, id LIMIT ?)",
                (portion,),
            ).rowcount
        return given_up


def _checksum(row: Row) -> int:
    """CRC-32 of a sample: SQLite has none of its own, and a flipped bit makes a wrong value."""
    _, asset, channel, time_us, value, quality, received_us = row
    try:
        numbers = _FIXED.pack(time_us, quality, received_us, math.nan if value is None else value)
        return zlib.crc32(f"{asset}\0{channel}".encode(), zlib.crc32(numbers))
    except (struct.error, TypeError, UnicodeEncodeError):
        return -1  # a damaged row has other kinds of values


def _salvage(row: Row) -> Row | None:
    """Accept values that can be a sample, the value as a number; None if they cannot."""
    rank, asset, channel, time_us, value, quality, received_us = row
    numbers = (rank, time_us, quality, received_us)
    if not (
        isinstance(asset, str)
        and isinstance(channel, str)
        and all(isinstance(number, int) for number in numbers)
        and isinstance(value, int | float | None)
        and 0 <= quality <= 255
        and 0 <= time_us < 2**63
    ):
        return None
    value = None if value is None else float(value)
    return rank, asset, channel, time_us, value, quality, received_us


_LAYOUT = QueueLayout(
    application_id=_APPLICATION_ID,
    tables=_TABLES,
    table="samples",
    key="id",
    columns=_COLUMNS,
    checksum=_checksum,
    salvage=_salvage,
    added_columns=[("checksum", "INTEGER")],
)
