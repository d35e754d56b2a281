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

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Engine
from sqlalchemy.exc import DatabaseError, InterfaceError, InternalError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from service.domain.errors import BearingTwinError
from service.store.blocks import ChannelSamples
from service.store.errors import StoreDamagedError, StoreUnavailableError

#: Wall seconds that a reader or a short transaction waits for its turn before it gives up.
PATIENCE_S = 30.0
#: Execution option of a connection that is going to write.
WRITES = "bearing_twin_writes"
#: Execution option of one that writes samples only, see `Database.writing_samples`.
WRITES_SAMPLES = "bearing_twin_writes_samples"

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


class AloneNeededError(BearingTwinError):
    """What was begun by `Database.writing_samples` needs `Database.writing`."""


def require_alone(connection: Connection) -> None:
    """Raise `AloneNeededError` where other programs write samples next to this one."""
    if connection.get_execution_options().get(WRITES_SAMPLES, False):
        raise AloneNeededError


class RollupColumns(NamedTuple):
    """Rows of the table of rollups column by column.

    Where no sample is good, the three values are not a number here, and missing in the table.
    """

    channel_ids: NDArray[np.int64]
    resolutions_s: NDArray[np.int64]
    times_us: NDArray[np.int64]
    means: NDArray[np.float64]
    lows: NDArray[np.float64]
    highs: NDArray[np.float64]
    good: NDArray[np.int64]
    qualities: NDArray[np.uint16]


Hours = Collection[tuple[int, int]]
"""Channels, and the begins of hours in UTC microseconds."""


@dataclass(frozen=True, slots=True)
class Dialect:
    """What differs between SQLite and PostgreSQL.

    - ``upsert_samples``: store rows, a connection and time never twice: the first good value wins,
      a good one replaces one that is not. Returns how many rows were added or replaced.
    - ``read_samples``: read the samples of channels of a half-open span, ascending by channel and
      time, up to a number.
    - ``insert_rollups``: store rows of which there are none yet.
    - ``lock_hours``: keep other programs, until the transaction ends, from the samples of these
      channels and hours. Returns those that are noted as stale by that, and were not before.
    - ``mark_stale``: note that the rollups of these channels and hours are not those of their
      samples. The last argument is what `lock_hours` gave: what is not stale is not any more.
    - ``with_patience``: limit, within a context, the wall seconds that a connection waits for
      others.
    """

    upsert_samples: Callable[[Connection, SampleColumns], int]
    read_samples: Callable[
        [Connection, Sequence[int], int, int, int], tuple[NDArray[np.int64], ChannelSamples]
    ]
    insert_rollups: Callable[[Connection, RollupColumns], None]
    lock_hours: Callable[[Connection, Hours], Hours]
    mark_stale: Callable[[Connection, Hours, Hours], None]
    with_patience: Callable[[Connection, float], AbstractContextManager[None]]


class Fence(Protocol):
    """Keeps a cell of a fleet from writing for what another cell owns."""

    def held(self, connection: Connection, assets: Collection[str]) -> Collection[str]:
        """Give those of some assets that stay this cell's until the transaction ends."""

    def deliverable(
        self, connection: Connection, assets: Collection[str], run: str
    ) -> Collection[str]:
        """Give those of some assets that no other has owned since this run of a cell."""


class StoreWitness(Protocol):
    """Notices that the store is another one, or lacks what it confirmed."""

    def admit(self, connection: Connection) -> int:
        """Admit a transaction that writes, or raise; gives its number."""

    def committed(self, number: int) -> None:
        """Record that the store has confirmed a transaction."""

    def check(self, connection: Connection) -> None:
        """See, without writing, whether a transaction would be admitted; raises as `admit`."""


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

    - ``name``: what to call it in messages: the path of the file, or the address without a
      password.
    - ``dialect``: what only this kind of database does.
    - ``writer``: connections that write; by default those that read do.
    - ``before_writing``: raises a `StoreUnavailableError` where nothing may be written.
    - ``fence``: asked before what the service derives from measurements is written; None: all is
      ours.
    - ``witness``: asked before anything is written; None: whatever store it is.
    """

    def __init__(
        self,
        engine: Engine,
        name: str,
        dialect: Dialect,
        writer: Engine | None = None,
        before_writing: Callable[[], None] = lambda: None,
    ) -> None:
        self.engine = engine
        self.name = name
        self.dialect = dialect
        self.fence: Fence | None = None
        self.witness: StoreWitness | None = None
        self._writer = writer or engine
        self._before_writing = before_writing
        self._turn = Turn()
        self._joined = threading.local()

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Give a connection that sees one unchanging state of the database.

        Raises `StoreUnavailableError` if the database does not answer.
        """
        with self._translated(), self.engine.connect() as connection:
            yield connection

    def writing(self, patience_s: float = PATIENCE_S) -> AbstractContextManager[Connection]:
        """Give a connection that holds the right to write; commit at the end, or roll back.

        ``patience_s``: wall seconds to wait for other writers, of this process and of others.
        Raises `StoreUnavailableError` if the database stayed locked, is away or cannot take the
        data now (disk full, I/O error).
        """
        return self._writing(patience_s)

    def writing_samples(self, patience_s: float = PATIENCE_S) -> AbstractContextManager[Connection]:
        """As `writing`, next to other programs that write samples of other channels and hours.

        Each writes samples, blocks and rollups only of those that it has locked, see
        `Dialect.lock_hours`, or states of assets that are its own (`Fence.held`), and no table but
        these. For more it needs to be alone: `AloneNeededError`. SQLite
        has one writer all the same.
        """
        return self._writing(patience_s, **{WRITES_SAMPLES: True})

    @contextmanager
    def together(self, patience_s: float = PATIENCE_S) -> Iterator[None]:
        """Have all that this thread writes meanwhile be one transaction: all of it, or nothing.

        An error must leave the context: what was written before it is not kept.
        """
        with self.writing(patience_s) as connection:
            self._joined.connection = connection
            try:
                yield
            finally:
                del self._joined.connection

    @contextmanager
    def _writing(self, patience_s: float, **options: bool) -> Iterator[Connection]:
        joined: Connection | None = getattr(self._joined, "connection", None)
        if joined is not None:
            yield joined
            return
        # The threads of this process queue here; SQLite itself lets contenders poll, and an
        # unlucky one could starve.
        if not self._turn.acquire(patience_s):
            raise StoreUnavailableError(f"{self.name}: busy with another write")
        try:
            self._before_writing()
            witness, number = self.witness, 0
            with self._translated(), self._writer.connect() as connection:
                connection = connection.execution_options(**{WRITES: True}, **options)
                with self.dialect.with_patience(connection, patience_s), connection.begin():
                    if witness is not None:
                        number = witness.admit(connection)
                    yield connection
            if witness is not None:
                witness.committed(number)
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
    """Whether an SQLite file makes no sense, rather than being away."""
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
