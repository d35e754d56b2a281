"""A file of its own for what waits on the disk: crash-safe, and put aside when it is damaged."""

import contextlib
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Self

import structlog

from service.store.errors import opening_error

_DAMAGED = sqlite3.DatabaseError

_log = structlog.get_logger(__name__)


class QueueUnavailableError(RuntimeError):
    """The file cannot be read or written now (disk full, I/O error)."""


class QueueFile:
    """An SQLite file whose commits are on the disk when they return. Safe from any thread.

    Parameters
    ----------
    connection : sqlite3.Connection
        Of the file.
    path : pathlib.Path
        The file, for messages.
    """

    def __init__(self, connection: sqlite3.Connection, path: Path) -> None:
        self._connection = connection
        self._path = path
        self._lock = threading.Lock()

    @classmethod
    def open(
        cls, path: Path, application_id: int, tables: str, probe: str, reserved_bytes: int = 0
    ) -> Self:
        """Open the file; what an earlier run left is still in it.

        A damaged file is put aside, with a log line, since a service that does not start would
        lose more.

        Parameters
        ----------
        path : pathlib.Path
            Made when it does not exist; the first part of its name is what messages call it.
        application_id : int
            Marks the file as ours.
        tables : str
            SQL that makes the tables where they are missing.
        probe : str
            SQL that fails on tables of another shape.
        reserved_bytes : int
            Room that the file keeps, so that a full disk can still take so much. Without it the
            file gives its room back to the disk when the queue has drained.

        Raises
        ------
        StoreError
            If the file can be neither opened nor made; one line that names it.
        """

        def connect() -> sqlite3.Connection:
            return _connect(path, application_id, tables, probe, reserved_bytes)

        try:
            try:
                return cls(connect(), path)
            except sqlite3.OperationalError:
                raise
            except _DAMAGED as error:
                aside = _put_aside(path)
                _log.error(
                    f"{path.stem}_damaged", file=str(path), kept_as=str(aside), error=str(error)
                )
                return cls(connect(), path)
        except (sqlite3.Error, OSError) as error:
            raise opening_error(
                f"{path.stem} {path}: {error}; expected a file that may be written", error
            ) from error

    @contextlib.contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """Give the connection, to nobody else meanwhile.

        Raises
        ------
        QueueUnavailableError
            If the file cannot be read now.
        """
        with self._lock:
            try:
                yield self._connection
            except sqlite3.DatabaseError as error:
                # The state of the disk or the file; the other kinds are the caller's mistakes.
                if isinstance(error, sqlite3.OperationalError) or type(error) is _DAMAGED:
                    raise QueueUnavailableError(f"{self._path}: {error}") from error
                raise

    @contextlib.contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Give the connection within a transaction, all or nothing of which is on the disk then.

        Raises
        ------
        QueueUnavailableError
            If the disk does not take it; then the file is as it was.
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


def _connect(
    path: Path, application_id: int, tables: str, probe: str, reserved_bytes: int
) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=1.0)
    try:
        # One file without the companions of a write-ahead log.
        connection.execute(f"PRAGMA auto_vacuum = {'NONE' if reserved_bytes else 'FULL'}")
        connection.execute(f"PRAGMA journal_mode = {'PERSIST' if reserved_bytes else 'TRUNCATE'}")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute(f"PRAGMA application_id = {application_id}")
        connection.executescript(tables)
        connection.execute(probe).fetchall()
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


def _put_aside(path: Path) -> Path:
    number = 1
    while (aside := path.with_name(f"{path.stem}-damaged-{number}{path.suffix}")).exists():
        number += 1
    path.rename(aside)
    return aside
