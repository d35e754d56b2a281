"""A file of its own for what waits on the disk: crash-safe, and mended when it is damaged."""

import contextlib
import os
import sqlite3
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import structlog

from service.domain.errors import BearingTwinError
from service.files import make_private_file
from service.store.errors import opening_error
from service.store.pages import PageRow, page_rows

_DAMAGED = sqlite3.DatabaseError
#: Primary codes of SQLite for a file that makes no sense, and codes for a part of it that cannot
#: be read.
_MALFORMED = {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}
_UNREADABLE = {
    sqlite3.SQLITE_IOERR_READ,
    sqlite3.SQLITE_IOERR_SHORT_READ,
    sqlite3.SQLITE_IOERR_CORRUPTFS,
}
#: A file that was found damaged this many times is mended while the service runs.
_PATIENCE = 3
_COMPANIONS = ("", "-journal", "-wal", "-shm")
#: Where the number of waiting rows stands in the first page of the file.
_COUNT_AT = 60
_HEADER_BYTES = 100
_SMALLEST_ROW_BYTES = 16
_LARGEST_NUMBER = 2**53
_LARGEST_BYTES = 2**36

_log = structlog.get_logger(__name__)


class QueueUnavailableError(BearingTwinError, RuntimeError):
    """The file cannot be read or written now (disk full, I/O error)."""


Row = Sequence[Any]
"""Values of a row of a queue, in the order of its columns."""


@dataclass(frozen=True, slots=True)
class Mended:
    """What became of a damaged file.

    - ``salvaged``: rows that were found in it, and wait again.
    - ``lost``: rows that were not found. Where the number of those that waited is damaged too, it
      is estimated from the gaps in their numbers.
    """

    kept_as: Path
    salvaged: int
    lost: int


@dataclass(frozen=True, slots=True)
class QueueLayout:
    """What a queue keeps in its file.

    - ``tables``: SQL that makes the tables where they are missing.
    - ``table``: the table whose rows wait.
    - ``key``: its first column, the number of the row.
    - ``columns``: its other columns, but for the last one, which is ``checksum``.
    - ``checksum``: the checksum of a row of these columns; it must not raise for a damaged one.
    - ``salvage``: turns values of those columns, from a row of any page, into a row; None if they
      are none.
    - ``added_columns``: columns, with their types, that files of earlier versions lack.
    - ``reserved_bytes``: room that the file keeps, so that a full disk can still take so much.
      Without it the file gives its room back to the disk when the queue has drained.
    """

    application_id: int
    tables: str
    table: str
    key: str
    columns: tuple[str, ...]
    checksum: Callable[[Row], int]
    salvage: Callable[[Row], Row | None]
    added_columns: Collection[tuple[str, str]] = ()
    reserved_bytes: int = 0

    @property
    def probe(self) -> str:
        """SQL that fails on a table of another shape."""
        names = ", ".join((self.key, *self.columns, "checksum"))
        return f"SELECT {names} FROM {self.table} LIMIT 1"

    def salvaged(self, found: PageRow) -> Row | None:
        """Turn a row of any page into one of the table; None if it is none, or is damaged."""
        # Rows of an earlier version have no checksum.
        missing = 1 + len(self.columns) - len(found.values)
        if found.rowid is None or missing not in (0, -1):
            return None
        row = self.salvage(found.values[1 : 1 + len(self.columns)])
        if row is None:
            return None
        checksum = found.values[-1] if missing else None
        if checksum is not None and checksum != self.checksum(row):
            return None
        return found.rowid, *row, checksum


class QueueFile:
    """An SQLite file whose commits are on the disk when they return. Safe from any thread.

    ``mended``: what became of the file when it was last found damaged. Raises `StoreError` if the
    file can be neither opened nor made; one line that names it.
    """

    def __init__(self, path: Path, layout: QueueLayout) -> None:
        self._path = path
        self.name = path.stem
        self.layout = layout
        self._lock = threading.RLock()
        self._failures = 0
        self._on_mended: Callable[[Mended], None] | None = None
        self.mended: Mended | None = None
        try:
            _finish_mending(path)
            try:
                self._connection = _checked(path, layout)
            except sqlite3.Error as error:
                # A table of another shape, which is no file of ours, gives a plain error.
                plain = getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_ERROR
                if not (plain or _is_damage(error)):
                    raise
                self._connection, self.mended = _mend(path, layout, error)
        except (sqlite3.Error, OSError) as error:
            raise opening_error(
                f"{path.stem} {path}: {error}; expected a file that may be written", error
            ) from error

    @classmethod
    def open(cls, path: Path, layout: QueueLayout) -> Self:
        """Open the file; what an earlier run left is still in it.

        A damaged file is set aside and what can be read of it salvaged, with a log line, since a
        service that does not start would lose more.
        """
        return cls(path, layout)

    def on_mended(self, react: Callable[[Mended], None]) -> None:
        """Have this called, while no one else has the connection, when the file was mended."""
        self._on_mended = react

    @contextlib.contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """Give the connection, to no one else meanwhile.

        Raises `QueueUnavailableError` if the file cannot be read now. When it turns out to be
        damaged again and again it is mended, and the next call finds what could be salvaged.
        """
        with self._lock:
            try:
                yield self._connection
            except sqlite3.DatabaseError as error:
                # The state of the disk or the file; the other kinds are the caller's mistakes.
                if isinstance(error, sqlite3.OperationalError) or type(error) is _DAMAGED:
                    self._note_failure(error)
                    raise QueueUnavailableError(f"{self._path}: {error}") from error
                raise

    @contextlib.contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Give the connection within a transaction, all or nothing of which is on the disk then.

        Raises `QueueUnavailableError` if the disk does not take it; then the file is as it was.
        """
        with self.reading() as connection:
            connection.execute("BEGIN IMMEDIATE")
            try:
                yield connection
                connection.execute("COMMIT")
            except BaseException:
                # A full disk may have ended the transaction already.
                with contextlib.suppress(sqlite3.Error):
                    connection.execute("ROLLBACK")
                raise

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._connection.close()

    def _note_failure(self, error: sqlite3.Error) -> None:
        # Other calls may go well in between: they read other pages.
        self._failures += _is_damage(error)
        if self._failures < _PATIENCE:
            return
        self._failures = 0
        self._connection.close()
        try:
            self._connection, self.mended = _mend(self._path, self.layout, error)
        except (sqlite3.Error, OSError) as problem:
            _log.error(f"{self._path.stem}_not_mended", file=str(self._path), error=str(problem))
            with contextlib.suppress(sqlite3.Error):
                self._connection = _connect(self._path, self.layout)
            return
        if self._on_mended is not None:
            self._on_mended(self.mended)


def note_count(connection: sqlite3.Connection, count: int) -> None:
    """Note within a transaction how many rows wait after it: a damaged file then shows its loss.

    The number is in the first page, which every commit writes anyway.
    """
    connection.execute(f"PRAGMA user_version = {min(count, 2**31 - 1)}")


def used_pages(connection: sqlite3.Connection) -> int:
    """Pages of the file that hold something."""
    pages = connection.execute("PRAGMA page_count").fetchone()[0]
    free = connection.execute("PRAGMA freelist_count").fetchone()[0]
    return int(pages) - int(free)


def _checked(path: Path, layout: QueueLayout) -> sqlite3.Connection:
    """Open a file that is whole. Raises `sqlite3.Error` if it is damaged, or cannot be used now."""
    there = path.exists()
    connection = _connect(path, layout)
    try:
        if there:
            ((verdict,),) = connection.execute("PRAGMA quick_check(1)").fetchall()
            if verdict != "ok":
                raise _DAMAGED(verdict)
    except BaseException:
        connection.close()
        raise
    return connection


def _is_damage(error: sqlite3.Error) -> bool:
    code = getattr(error, "sqlite_errorcode", None)
    if code is None:  # ours, or a part of the driver's own checks
        return type(error) is _DAMAGED
    return code & 0xFF in _MALFORMED or code in _UNREADABLE


def _connect(path: Path, layout: QueueLayout) -> sqlite3.Connection:
    make_private_file(path)
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=1.0)
    reserved_bytes = layout.reserved_bytes
    try:
        # One file without the companions of a write-ahead log.
        connection.execute(f"PRAGMA auto_vacuum = {'NONE' if reserved_bytes else 'FULL'}")
        connection.execute(f"PRAGMA journal_mode = {'PERSIST' if reserved_bytes else 'TRUNCATE'}")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute(f"PRAGMA application_id = {layout.application_id}")
        connection.executescript(layout.tables)
        known = {row[1] for row in connection.execute(f"PRAGMA table_info({layout.table})")}
        for name, kind in layout.added_columns:
            if name not in known:
                connection.execute(f"ALTER TABLE {layout.table} ADD COLUMN {name} {kind}")
        connection.execute(layout.probe).fetchall()
        if reserved_bytes > _size_bytes(connection):
            # Two commits: room that is taken and left in one is never written.
            connection.execute("CREATE TABLE IF NOT EXISTS reserve (room BLOB)")
            connection.execute("INSERT INTO reserve VALUES (zeroblob(?))", (reserved_bytes,))
        connection.execute("DROP TABLE IF EXISTS reserve")
    except BaseException:
        connection.close()
        raise
    return connection


def _size_bytes(connection: sqlite3.Connection) -> int:
    pages, page_bytes = (
        int(connection.execute(f"PRAGMA {name}").fetchone()[0])
        for name in ("page_count", "page_size")
    )
    return pages * page_bytes


# ---------------------------------------------------------------------- a damaged file
def _mend(
    path: Path, layout: QueueLayout, cause: sqlite3.Error
) -> tuple[sqlite3.Connection, Mended]:
    """Put what can be read of a damaged file into a new one, and set the damaged one aside."""
    new = _new_name(path)
    _remove(new)
    waited, most = _noted_count(path)
    connection = _connect(new, layout)
    try:
        salvaged, first, last = _copy_rows(path, layout, connection)
    except (sqlite3.Error, OSError) as error:
        # A full disk, say: an empty queue is better than none.
        _log.error(f"{path.stem}_not_salvaged", file=str(path), error=str(error))
        connection.close()
        _remove(new)
        connection = _connect(new, layout)
        salvaged, first, last = 0, 0, -1
    if waited is None or waited < salvaged:
        waited = min(last - first + 1, most)
    connection.close()
    kept_as = set_aside(path)
    _finish_mending(path)
    mended = Mended(kept_as, salvaged, max(waited - salvaged, 0))
    _log.error(
        f"{path.stem}_damaged",
        file=str(path),
        kept_as=str(kept_as),
        salvaged=mended.salvaged,
        lost=mended.lost,
        error=str(cause),
    )
    return _connect(path, layout), mended


def _copy_rows(
    path: Path, layout: QueueLayout, connection: sqlite3.Connection
) -> tuple[int, int, int]:
    """Copy the rows; returns their count, and the first and the last of their numbers."""
    latest = -1
    columns = connection.execute(f"SELECT * FROM {layout.table} LIMIT 0").description
    key, names = columns[0][0], [column[0] for column in columns[1:]]
    places = ", ".join("?" * len(columns))
    insert = f"INSERT OR IGNORE INTO {layout.table} VALUES ({places})"
    same = " AND ".join(f"{name} IS ?" for name in (key, *names))
    is_there = f"SELECT 1 FROM {layout.table} WHERE {same}"
    connection.execute("BEGIN IMMEDIATE")
    for found in page_rows(path):
        if len(found.values) == 2 and found.values[0] == layout.table:
            # SQLite's own note of the latest number of the table.
            if isinstance(found.values[1], int):
                latest = found.values[1]
            continue
        row = layout.salvaged(found)
        if row is None or not 0 < row[0] < _LARGEST_NUMBER:
            continue
        taken = connection.execute(insert, row).rowcount == 0
        if taken and connection.execute(is_there, row).fetchone() is None:
            # Another row has its number, which is what is damaged: it gets the next one.
            connection.execute(insert, (None, *row[1:]))
    count, first, last = connection.execute(
        f"SELECT COUNT(*), MIN({key}), MAX({key}) FROM {layout.table}"
    ).fetchone()
    note_count(connection, count)
    connection.execute("COMMIT")
    return count, first or 0, max(latest, -1 if last is None else last)


def _noted_count(path: Path) -> tuple[int | None, int]:
    """How many rows the file says that it holds, None where that cannot be; and at most."""
    try:
        with path.open("rb") as file:
            header = file.read(_HEADER_BYTES)
            size = file.seek(0, os.SEEK_END)
    except OSError:
        return None, 0
    if not header.startswith(b"SQLite format 3\0"):
        return None, size // _SMALLEST_ROW_BYTES
    page_bytes, pages = int.from_bytes(header[16:18], "big"), int.from_bytes(header[28:32], "big")
    # A file that was cut off was longer.
    most = max(size, min(page_bytes * pages, _LARGEST_BYTES)) // _SMALLEST_ROW_BYTES
    count = int.from_bytes(header[_COUNT_AT : _COUNT_AT + 4], "big")
    return (count if 0 < count <= most else None), most


def _new_name(path: Path) -> Path:
    return path.with_name(f"{path.stem}-salvaged{path.suffix}")


def _finish_mending(path: Path) -> None:
    """Take what was salvaged into use, also when an earlier run ended between the two steps."""
    if not path.exists() and _new_name(path).exists():
        _new_name(path).replace(path)


def set_aside(path: Path) -> Path:
    """Rename a damaged file with its companions, and return its new name."""
    number = 1
    while (aside := path.with_name(f"{path.stem}-damaged-{number}{path.suffix}")).exists():
        number += 1
    for companion in reversed(_COMPANIONS):
        there = path.with_name(path.name + companion)
        if there.exists():
            there.rename(aside.with_name(aside.name + companion))
    return aside


def _remove(path: Path) -> None:
    for companion in _COMPANIONS:
        path.with_name(path.name + companion).unlink(missing_ok=True)
