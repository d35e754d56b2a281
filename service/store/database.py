"""The database connection: how it is read from and written to, whatever the server."""

import json
import sqlite3
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from itertools import compress
from typing import NamedTuple, Protocol

from sqlalchemy import Connection, Engine
from sqlalchemy.exc import DatabaseError, InterfaceError, InternalError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from service.store.errors import StoreDamagedError, StoreUnavailableError

#: Wall seconds that a reader or a short transaction waits for its turn before it gives up.
PATIENCE_S = 30.0
#: Execution option of a connection that is going to write.
WRITES = "bearing_twin_writes"

SampleValues = tuple[int, int, float | None, int, int | None]
"""Channel number, time in UTC microseconds, value, quality, received time: a row of samples."""


class SampleColumns(NamedTuple):
    """Rows of the table of samples column by column, which is how they are made fastest."""

    channel_ids: Sequence[int]
    times_us: Sequence[int]
    values: Sequence[float | None]
    qualities: Sequence[int]
    received_us: Sequence[int | None]


def chosen(columns: SampleColumns, kept: Sequence[bool]) -> SampleColumns:
    """Give some of the rows."""
    ids, times_us, values, qualities, received_us = columns
    return SampleColumns(
        list(compress(ids, kept)),
        list(compress(times_us, kept)),
        list(compress(values, kept)),
        list(compress(qualities, kept)),
        list(compress(received_us, kept)),
    )


@dataclass(frozen=True, slots=True)
class Dialect:
    """What differs between SQLite and PostgreSQL.

    Attributes
    ----------
    upsert_samples
        Store rows, a connection and time never twice: the first good value wins, a good one
        replaces one that is not. Returns how many rows were added or replaced.
    mark_stale
        Note that the rollups of these channels and hours are not those of their samples.
    with_patience
        Limit, within a context, the wall seconds that a connection waits for others.
    """

    upsert_samples: Callable[[Connection, SampleColumns], int]
    mark_stale: Callable[[Connection, Collection[tuple[int, int]]], None]
    with_patience: Callable[[Connection, float], AbstractContextManager[None]]


class Fence(Protocol):
    """Keeps a cell of a fleet from writing for what another cell owns."""

    def held(self, connection: Connection, assets: Collection[str]) -> Collection[str]:
        """Give those of some assets that stay this cell's until the transaction ends."""

    def deliverable(
        self, connection: Connection, assets: Collection[str], run: str
    ) -> Collection[str]:
        """Give those of some assets that nobody has owned since this run of a cell."""


class Turn:
    """A lock that the threads of a process get in the order in which they asked for it.

    With a plain lock, a thread that releases it and asks again at once, as one does that computes
    a thousand rollups, gets it before those that wait.
    """

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._waiting: deque[threading.Event] = deque()
        self._is_taken = False

    def acquire(self, timeout_s: float) -> bool:
        """Wait for the turn; False when it did not come within this many wall seconds."""
        with self._guard:
            if not self._is_taken:
                self._is_taken = True
                return True
            called = threading.Event()
            self._waiting.append(called)
        if called.wait(timeout_s):
            return True
        with self._guard:
            if called.is_set():  # at the last moment
                return True
            self._waiting.remove(called)
        return False

    def release(self) -> None:
        """Give the turn to who has waited longest."""
        with self._guard:
            if self._waiting:
                self._waiting.popleft().set()
            else:
                self._is_taken = False


class Database:
    """One database: any number of readers, one writer at a time of each process.

    Attributes
    ----------
    engine : sqlalchemy.Engine
        Its connections begin a transaction by themselves; use `reading` and `writing`.
    name : str
        What to call it in messages: the path of the file, or the address without a password.
    dialect : Dialect
        What only this kind of database does.
    writer : sqlalchemy.Engine, optional
        Connections that write; by default those that read do.
    fence : Fence, optional
        Asked before what the service derives from measurements is written; None: all is ours.
    """

    def __init__(
        self, engine: Engine, name: str, dialect: Dialect, writer: Engine | None = None
    ) -> None:
        self.engine = engine
        self.name = name
        self.dialect = dialect
        self.fence: Fence | None = None
        self._writer = writer or engine
        self._turn = Turn()

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Give a connection that sees one unchanging state of the database.

        Raises
        ------
        StoreUnavailableError
            If the database does not answer.
        """
        with self._translated(), self.engine.connect() as connection:
            yield connection

    @contextmanager
    def writing(self, patience_s: float = PATIENCE_S) -> Iterator[Connection]:
        """Give a connection that holds the right to write; commit at the end, or roll back.

        Parameters
        ----------
        patience_s : float
            Wall seconds to wait for other writers, of this process and of others.

        Raises
        ------
        StoreUnavailableError
            If the database stayed locked, is away or cannot take the data now (disk full, I/O
            error).
        """
        # The threads of this process queue here; SQLite itself lets contenders poll, and an
        # unlucky one could starve.
        if not self._turn.acquire(patience_s):
            raise StoreUnavailableError(f"{self.name}: busy with another write")
        try:
            with self._translated(), self._writer.connect() as connection:
                connection = connection.execution_options(**{WRITES: True})
                with self.dialect.with_patience(connection, patience_s), connection.begin():
                    yield connection
        finally:
            self._turn.release()

    @contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except PoolTimeoutError as error:
            raise StoreUnavailableError(f"{self.name}: {error}") from error
        except InterfaceError as error:
            raise StoreUnavailableError(f"{self.name}: {_one_line(error.orig)}") from error
        except DatabaseError as error:
            # Locked, full, I/O error, damaged, gone: the state of disk or server. The other kinds
            # (a broken constraint, a wrong statement) are the caller's.
            if is_damage(error.orig):
                raise StoreDamagedError(damaged(self.name, error.orig)) from error
            if isinstance(error, OperationalError | InternalError) or type(error) is DatabaseError:
                raise StoreUnavailableError(f"{self.name}: {_one_line(error.orig)}") from error
            raise
        except (json.JSONDecodeError, UnicodeDecodeError) as error:
            raise StoreDamagedError(damaged(self.name, error)) from error

    def close(self) -> None:
        """Close every connection."""
        self.engine.dispose()
        self._writer.dispose()


def is_damage(error: BaseException | None) -> bool:
    """Tell whether an SQLite file makes no sense, rather than being away."""
    code = getattr(error, "sqlite_errorcode", 0) or 0
    return (
        code & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
        or code
        in (
            sqlite3.SQLITE_IOERR_READ,
            sqlite3.SQLITE_IOERR_SHORT_READ,
            sqlite3.SQLITE_IOERR_CORRUPTFS,
        )
        or "Could not decode to UTF-8" in str(error)
    )


def damaged(name: str, error: BaseException | None) -> str:
    """Say that a store is damaged and what to do, in one line."""
    return (
        f"store {name}: damaged ({_one_line(error)}); stop the service and run "
        "'bearing-twin db salvage', or restore a backup"
    )


def _one_line(error: BaseException | None) -> str:
    return " ".join(str(error).split())
