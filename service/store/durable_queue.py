"""A queue on the disk: in order, crash-safe, with a checksum for each row, and never miscounted."""

import sqlite3
from collections.abc import Callable, Sequence

import structlog

from service.store.closable import Closable
from service.store.queue_file import Mended, QueueFile, Row, note_count

_log = structlog.get_logger(__name__)

MakeRoom = Callable[[sqlite3.Connection, int], int]
"""Gives rows up, given how many there are; returns how many it gave up."""


class DurableQueue(Closable):
    """Rows that wait in a file of their own; for the spool and the outbox alike.

    What was appended is on the disk when `append` returns, and stays there until `remove`. Safe to
    call from any thread. Every method raises `QueueUnavailableError` when the file cannot be read
    or written now; then nothing has changed. ``file`` is closed with the queue. `lost` counts rows
    that damage of the file has cost in this run.
    """

    def __init__(self, file: QueueFile) -> None:
        self.file = file
        self.lost = 0 if file.mended is None else file.mended.lost
        self._on_mended: Callable[[], None] = lambda: None
        file.on_mended(self._note_mended)
        layout = file.layout
        self._table, self._checksum = layout.table, layout.checksum
        names = ", ".join((*layout.columns, "checksum"))
        places = ", ".join("?" * (len(layout.columns) + 1))
        self._insert = f"INSERT INTO {self._table} ({names}) VALUES ({places})"
        self._select = (
            f"SELECT {layout.key}, {names} FROM {self._table} WHERE {layout.key} > ? "
            f"ORDER BY {layout.key} LIMIT ?"
        )
        self._delete = f"DELETE FROM {self._table} WHERE {layout.key} <= ?"
        self._delete_one = f"DELETE FROM {self._table} WHERE {layout.key} = ?"
        with file.reading() as connection:
            counted = connection.execute(f"SELECT COUNT(*) FROM {self._table}").fetchone()
        self._count = int(counted[0])

    def __len__(self) -> int:
        """Rows that wait."""
        return self._count

    @property
    def mended(self) -> Mended | None:
        """What became of the file when it was last found damaged in this run."""
        return self.file.mended

    def on_mended(self, react: Callable[[], None]) -> None:
        """Have this called when the file was mended: its numbers may begin again."""
        self._on_mended = react

    def append(self, rows: Sequence[Row], make_room: MakeRoom | None = None) -> int:
        """Put rows at the end, all or none; returns how many were given up to make room."""
        checked = [(*row, self._checksum(row)) for row in rows]
        with self.file.reading():  # also until the count is right
            with self.file.writing() as connection:
                connection.executemany(self._insert, checked)
                count = self._count + len(checked)
                given_up = make_room(connection, count) if make_room else 0
                note_count(connection, count - given_up)
            self._count += len(checked) - given_up
        return given_up

    def first(self, limit: int, after: int = 0) -> list[tuple[int, Row | None]]:
        """Read the oldest rows behind a number, with their numbers; None for a damaged one."""
        with self.file.reading() as connection:
            found = connection.execute(self._select, (after, limit)).fetchall()
            if not found and not after:
                # What was counted is not there, however that came about.
                self.lost += self._count
                self._count = 0
        # Rows of an earlier version have no checksum.
        return [
            (number, row if checksum is None or checksum == self._checksum(row) else None)
            for number, *row, checksum in found
        ]

    def one(self, number: int) -> Row | None:
        """Read the row of a number; None if it is damaged or not there."""
        found = self.first(1, number - 1)
        return found[0][1] if found and found[0][0] == number else None

    def discard(self, numbers: Sequence[int]) -> None:
        """Forget the rows of some numbers."""
        with self.file.reading():
            with self.file.writing() as connection:
                removed = 0
                for number in numbers:
                    removed += connection.execute(self._delete_one, (number,)).rowcount
                note_count(connection, self._count - removed)
            self._count -= removed

    def remove(self, last: int) -> None:
        """Forget the rows up to a number."""
        with self.file.reading():
            with self.file.writing() as connection:
                removed = connection.execute(self._delete, (last,)).rowcount
                note_count(connection, self._count - removed)
            self._count -= removed

    def note_damaged(self, count: int) -> None:
        """Count damaged rows that were removed."""
        if count:
            self.lost += count
            _log.error(f"{self.file.name}_rows_damaged", lost=count)

    def close(self) -> None:
        """Close the file."""
        self.file.close()

    def _note_mended(self, mended: Mended) -> None:
        # What waited is known better than the damaged file can say.
        self.lost += max(self._count - mended.salvaged, 0)
        self._count = mended.salvaged
        self._on_mended()
