"""SQLite: one file, readers never wait, a commit is on the disk when it returns."""

import contextlib
import os
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from glob import escape
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError
from sqlalchemy.pool import ConnectionPoolEntry

from adapters.samples import Quality
from service.files import make_private_file, make_private_folder
from service.store.blocks import UNKNOWN_US, ChannelSamples
from service.store.copies import copy_sqlite
from service.store.database import (
    PATIENCE_S,
    WRITES,
    Database,
    Dialect,
    Hours,
    RollupColumns,
    SampleColumns,
    damaged,
    is_damage,
)
from service.store.errors import (
    StoreDamagedError,
    StoreDoubtedError,
    StoreError,
    opening_error,
)
from service.store.locking import who_uses
from service.store.migrations import is_current, make_tables, upgrade
from service.store.sqlite_file import GUARD, connect_file

_Number = TypeVar("_Number", np.int64, np.float64, np.uint16)

#: The first good value of a time wins; a good one replaces one that is not; the rest changes
#: nothing and is not counted as a change.
_UPSERT = f"""
INSERT INTO samples (channel_id, time_us, value, quality, received_us) VALUES {{}}
ON CONFLICT (channel_id, time_us) DO UPDATE
SET value = excluded.value, quality = excluded.quality, received_us = excluded.received_us
WHERE samples.quality < {Quality.GOOD:d} AND excluded.quality >= {Quality.GOOD:d}
"""
_ROW = "(?, ?, ?, ?, ?)"
#: This many rows go in by one statement: the other threads run meanwhile, which they cannot when
#: every row is a step of its own. SQLite takes 32,766 parameters.
_ROWS = 1024
#: Of the file that the write-ahead log leaves when all of it is in the store.
_LOG_BYTES = 16 * 1024 * 1024
#: Copies that upgrades of the tables have left.
_KEPT_COPIES = 3
_UPSERT_ONE = _UPSERT.format(_ROW)
_INSERT_ROLLUPS = (
    "INSERT INTO rollups (channel_id, resolution_s, time_us, mean, low, high, good, quality) "
    "VALUES (?, ?, ?, ?, ?, ?, ?, ?)"
)
_MARK_STALE = "INSERT OR IGNORE INTO stale_rollups (channel_id, hour_us) VALUES (?, ?)"
#: Of thousands of channels each has a page that it is being written to: the one connection that
#: writes keeps them in memory (KiB), and copies them (pages of 4 KiB) into the file more rarely
#: than at every thousandth.
_WRITER_CACHE_KIB = 64 * 1024
_WRITER_CHECKPOINT_PAGES = 4000
_UPSERT_MANY = _UPSERT.format(", ".join([_ROW] * _ROWS))


def open_sqlite(url: URL) -> Database:
    """Open the file, make it when it is new, and bring its tables up to date.

    Raises `StoreError` if the file cannot be used, is not ours or is damaged; one line that names
    it. Raises `StoreUnavailableError` if it stays locked, or the disk is full: that may pass by
    itself.
    """
    path = Path(url.database or "")
    try:
        make_private_folder(path.parent)
    except OSError as error:
        raise opening_error(
            f"data directory {error.filename}: cannot be made ({error.strerror})", error
        ) from error
    make_private_file(path)
    engine = _engine(url, pool_size=8, max_overflow=32)
    try:
        with engine.connect() as connection:
            # Readers never wait for the writer; the file remembers it.
            raw: Any = connection.connection.driver_connection
            raw.execute("PRAGMA journal_mode = WAL")
        if not is_current(engine):
            if _has_tables(path):
                _prepare_upgrade(path)
                upgrade(engine)
            else:
                make_tables(engine)
        with engine.connect() as connection:
            connection.execution_options(**{WRITES: True}).begin().rollback()
    except (DBAPIError, sqlite3.Error) as error:
        engine.dispose()
        cause = error.orig if isinstance(error, DBAPIError) else error
        if is_damage(cause) and path.stat().st_size and _is_sqlite(path):
            raise StoreDamagedError(damaged(str(path), cause)) from error
        raise opening_error(f"store {path}: {_explained(cause)}", cause) from error
    except StoreDamagedError:
        engine.dispose()
        raise
    except StoreError as error:
        engine.dispose()
        raise type(error)(f"store {path}: {error}") from error
    dialect = Dialect(
        _upsert_samples, _read_samples, _insert_rollups, _lock_hours, _mark_stale, _with_patience
    )
    return Database(engine, str(path), dialect, _writer(url), _require_same(path))


def _require_same(path: Path) -> Callable[[], None]:
    """Give what raises when the path names another file than now.

    Connections stay with the file that they were opened on: what goes to it is lost.
    """
    place = path.stat()

    def require() -> None:
        try:
            same = os.path.samestat(place, path.stat())
        except FileNotFoundError:
            same = False
        if not same:
            raise StoreDoubtedError(
                f"store {path}: the file was removed or replaced while the service runs; nothing "
                "is written until the service is started again"
            )

    return require


def _has_tables(path: Path) -> bool:
    with contextlib.closing(connect_file(path, timeout_s=PATIENCE_S)) as connection:
        return connection.execute("SELECT 1 FROM sqlite_master").fetchone() is not None


def _prepare_upgrade(path: Path) -> None:
    """Make sure that no older service runs on a store with tables, and keep a copy of it."""
    with contextlib.closing(connect_file(path, timeout_s=PATIENCE_S)) as connection:
        (revision,) = connection.execute("SELECT version_num FROM alembic_version").fetchone()
    holder = who_uses(path)
    if holder is not None:
        raise StoreError(
            f"its tables ({revision}) are those of an earlier version, and a service is running "
            f"on it{holder}; stop that service first"
        )
    copy = path.with_name(f"{path.stem}-before-upgrade-{revision}{path.suffix}")
    if not copy.exists():
        copy_sqlite(path, copy)
    copies = sorted(path.parent.glob(f"{escape(path.stem)}-before-upgrade-*{path.suffix}"))
    for old in copies[:-_KEPT_COPIES]:
        old.unlink()


def _upsert_samples(connection: Connection, columns: SampleColumns) -> int:
    count = len(columns.times_us)
    if count > 1:
        # Channel by channel, each in the order in which it came: SQLite need not look for the page
        # of every row again.
        order = itemgetter(*sorted(range(count), key=columns.channel_ids.__getitem__))
        columns = SampleColumns(*map(order, columns))
    whole = count - count % _ROWS
    changed = 0
    for first in range(0, whole, _ROWS):
        parameters: list[float | None] = [None] * (len(columns) * _ROWS)
        for number, column in enumerate(columns):
            parameters[number :: len(columns)] = column[first : first + _ROWS]
        changed += connection.exec_driver_sql(_UPSERT_MANY, tuple(parameters)).rowcount
    if whole < count:
        rest = list(zip(*(column[whole:] for column in columns), strict=True))
        changed += connection.exec_driver_sql(_UPSERT_ONE, rest).rowcount
    return changed


def _read_samples(
    connection: Connection, channel_ids: Sequence[int], begin_us: int, end_us: int, count_max: int
) -> tuple[NDArray[np.int64], ChannelSamples]:
    numbers = ", ".join(map(str, channel_ids))
    query = (
        "SELECT channel_id, time_us, value, quality, received_us FROM samples "
        f"WHERE channel_id IN ({numbers}) AND time_us >= ? AND time_us < ? "
        "ORDER BY channel_id, time_us LIMIT ?"
    )
    result = connection.exec_driver_sql(query, (begin_us, end_us, count_max))
    try:
        rows = result.cursor.fetchall() if result.cursor else []  # without a step for each row
    except sqlite3.Error as error:
        raise DBAPIError.instance(query, None, error, sqlite3.Error) from error
    finally:
        result.close()
    try:
        return _column(rows, 0, np.int64), ChannelSamples(
            _column(rows, 1, np.int64),
            _column(rows, 2, np.float64),
            _column(rows, 3, np.uint16),
            _column(rows, 4, np.int64),
        )
    except (TypeError, ValueError, OverflowError) as error:  # what no program has stored
        path = connection.engine.url.database or ""
        raise StoreDamagedError(damaged(path, error)) from error


def _column(rows: Sequence[Any], place: int, kind: type[_Number]) -> NDArray[_Number]:
    try:
        return np.fromiter(map(itemgetter(place), rows), kind, len(rows))
    except TypeError:  # something is missing: a value, or the received time of an earlier version
        missing = np.nan if kind is np.float64 else UNKNOWN_US
        return np.array([missing if row[place] is None else row[place] for row in rows], kind)


def _insert_rollups(connection: Connection, columns: RollupColumns) -> None:
    lists = [column.tolist() for column in columns]
    for place in range(3, 6):
        lists[place] = [None if value != value else value for value in lists[place]]
    connection.exec_driver_sql(_INSERT_ROLLUPS, list(zip(*lists, strict=True)))


def _lock_hours(_connection: Connection, _hours: Hours) -> Hours:
    return ()  # who writes is alone


def _mark_stale(connection: Connection, hours: Hours, _locked: Hours) -> None:
    if hours:
        connection.exec_driver_sql(_MARK_STALE, list(hours))


@contextmanager
def _with_patience(connection: Connection, patience_s: float) -> Iterator[None]:
    raw: Any = connection.connection.driver_connection
    raw.execute(f"PRAGMA busy_timeout = {round(patience_s * 1000)}")
    try:
        yield
    finally:
        raw.execute(f"PRAGMA busy_timeout = {round(PATIENCE_S * 1000)}")


def _writer(url: URL) -> Engine:
    """Make the one connection of a process that writes, when it is needed first.

    Another one would find none of the pages in its memory, and that of this one gone stale.
    """
    engine = _engine(url, pool_size=1, max_overflow=0)

    def prepare(connection: sqlite3.Connection, _entry: ConnectionPoolEntry) -> None:
        connection.execute(f"PRAGMA cache_size = -{_WRITER_CACHE_KIB}")
        connection.execute(f"PRAGMA wal_autocheckpoint = {_WRITER_CHECKPOINT_PAGES}")

    event.listen(engine, "connect", prepare)
    return engine


def _engine(url: URL, pool_size: int, max_overflow: int) -> Engine:
    engine = create_engine(
        url,
        connect_args={"timeout": PATIENCE_S},
        pool_size=pool_size,
        max_overflow=max_overflow,
        pool_timeout=PATIENCE_S,
    )

    def prepare(connection: sqlite3.Connection, _entry: ConnectionPoolEntry) -> None:
        # The driver's own idea of when a transaction begins is switched off: see `begin`.
        connection.isolation_level = None
        connection.execute(GUARD)
        # A commit is on the disk when it returns: what was acknowledged outlives a power cut.
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = ON")
        # A long reader makes the write-ahead log grow; behind it the file gets small again.
        connection.execute(f"PRAGMA journal_size_limit = {_LOG_BYTES}")

    def begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get(WRITES, False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    event.listen(engine, "connect", prepare)
    event.listen(engine, "begin", begin)
    return engine


def _is_sqlite(path: Path) -> bool:
    """Whether a file looks like one of SQLite, if only by the kind of its second page."""
    with path.open("rb") as file:
        begin = file.read(16)
        if begin == b"SQLite format 3\0":
            return True
        file.seek(4096)
        return file.read(1) in (b"\x02", b"\x05", b"\x0a", b"\x0d")


def _explained(cause: BaseException | None) -> str:
    text = str(cause)
    if "not a database" in text:
        return "not an SQLite database; expected a file made by bearing-twin"
    if "unable to open" in text:
        return "cannot be opened; expected a path that may be written"
    if "readonly" in text:
        return "may not be written"
    return text
