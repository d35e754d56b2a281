"""Samples on the disk that wait for a store which is away: bounded, in order, crash-safe."""

import math
import sqlite3
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple, Self

from adapters.samples import Sample, is_bad
from service.store import QueueFile

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
    received_us INTEGER NOT NULL
)
"""
_PROBE = "SELECT id, importance, received_us FROM samples LIMIT 1"
_INSERT = """
INSERT INTO samples (importance, asset, channel, time_us, value, quality, received_us)
VALUES (?, ?, ?, ?, ?, ?, ?)
"""


class Chunk(NamedTuple):
    """The oldest samples of the spool; `last_id` removes them when they are stored."""

    last_id: int
    samples: list[Sample]


class Spool:
    """A bounded queue of samples in an SQLite file of its own.

    What was appended is on the disk when `append` returns, and stays there until `remove`. Safe
    to call from any thread.

    Parameters
    ----------
    file : QueueFile
        The spool's file.
    size_mib : int
        Size that the samples may take. A full spool gives up the oldest samples of the least
        important channels.
    """

    def __init__(self, file: QueueFile, size_mib: int) -> None:
        self._file = file
        with file.reading() as connection:
            self._page_bytes = int(connection.execute("PRAGMA page_size").fetchone()[0])
            self._count = int(connection.execute("SELECT COUNT(*) FROM samples").fetchone()[0])
        self._pages_max = max(size_mib * _BYTES_PER_MIB // self._page_bytes, 16)

    @classmethod
    def open(cls, folder: Path, size_mib: int) -> Self:
        """Open the spool of a data directory; samples of an earlier run are still in it.

        Raises
        ------
        StoreError
            If the file can be neither opened nor made; one line that names it.
        """
        return cls(QueueFile.open(folder / FILE_NAME, _APPLICATION_ID, _TABLES, _PROBE), size_mib)

    def __len__(self) -> int:
        """Samples that wait."""
        return self._count

    @property
    def size_bytes(self) -> int:
        """What the samples take on the disk."""
        with self._file.reading() as connection:
            return _used_pages(connection) * self._page_bytes

    def oldest_received_us(self) -> int | None:
        """Receipt time of the sample that waits longest; None when none waits.

        Raises
        ------
        QueueUnavailableError
            If the file cannot be read now.
        """
        with self._file.reading() as connection:
            row = connection.execute(
                "SELECT received_us FROM samples ORDER BY id LIMIT 1"
            ).fetchone()
        return None if row is None else int(row[0])

    def append(self, samples: Collection[Sample]) -> int:
        """Put samples at the end; when this returns they are on the disk.

        Returns
        -------
        int
            Samples that were given up to make room, the oldest of the least important channels.

        Raises
        ------
        QueueUnavailableError
            If the disk does not take them; then none is in the spool.
        """
        rows = [
            (
                importance(one.channel),
                one.asset,
                one.channel,
                one.time_us,
                one.value if math.isfinite(one.value) else None,
                int(one.quality),
                one.received_us,
            )
            for one in samples
        ]
        with self._file.writing() as connection:
            connection.executemany(_INSERT, rows)
            given_up = self._make_room(connection, self._count + len(rows))
        self._count += len(rows) - given_up
        return given_up

    def first(self, limit: int) -> Chunk | None:
        """Read the oldest samples, in the order in which they came; None when there are none.

        Raises
        ------
        QueueUnavailableError
            If the file cannot be read now.
        """
        with self._file.reading() as connection:
            rows = connection.execute(
                "SELECT id, asset, channel, time_us, value, quality, received_us FROM samples "
                "ORDER BY id LIMIT ?",
                (limit,),
            ).fetchall()
        if not rows:
            return None
        samples = [
            Sample(asset, channel, time_us, math.nan if value is None else value, quality, received)
            for _, asset, channel, time_us, value, quality, received in rows
        ]
        return Chunk(rows[-1][0], samples)

    def remove(self, chunk: Chunk) -> None:
        """Forget samples that are in the store now.

        Raises
        ------
        QueueUnavailableError
            If the disk does not take the change; they will be read, and stored, once more.
        """
        with self._file.writing() as connection:
            connection.execute("DELETE FROM samples WHERE id <= ?", (chunk.last_id,))
        self._count -= len(chunk.samples)

    def newest(self) -> dict[tuple[str, str], int | None]:
        """Time of the newest sample of each asset and channel; None where it is bad."""
        with self._file.reading() as connection:
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
        self._file.close()

    def _make_room(self, connection: sqlite3.Connection, count: int) -> int:
        given_up = 0
        while _used_pages(connection) > self._pages_max and given_up < count:
            portion = max(int(count * _MAKE_ROOM), 1)
            given_up += connection.execute(
                "DELETE FROM samples WHERE id IN "
                "(SELECT id FROM samples ORDER BY importance, id LIMIT ?)",
                (portion,),
            ).rowcount
        return given_up


def importance(channel: str) -> int:
    """Rank a channel for a spool that must give something up; the lowest goes first.

    What the twin computed can be computed again; a measured ring temperature cannot.
    """
    if "." in channel:
        return 0
    if channel in ("t_inner_ring_c", "t_outer_ring_c"):
        return 3
    if channel in ("speed_rpm", "load_n", "ambient_c"):
        return 2
    return 1


def _used_pages(connection: sqlite3.Connection) -> int:
    pages = connection.execute("PRAGMA page_count").fetchone()[0]
    free = connection.execute("PRAGMA freelist_count").fetchone()[0]
    return int(pages) - int(free)
