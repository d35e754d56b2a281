"""The database connection: how it is opened, read from and written to."""

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import (
    ArgumentError,
    DatabaseError,
    DBAPIError,
    InternalError,
    OperationalError,
)
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from sqlalchemy.pool import ConnectionPoolEntry

from service.store.errors import StoreError, StoreUnavailableError
from service.store.migrations import is_current, upgrade

FILE_NAME = "bearing-twin.db"
#: Wall seconds that a reader or a short transaction waits for its turn before it gives up.
PATIENCE_S = 30.0
#: Execution option of a connection that is going to write.
_WRITES = "bearing_twin_writes"


class Database:
    """One database file: any number of readers, one writer at a time.

    Attributes
    ----------
    engine : sqlalchemy.Engine
        Its connections begin a transaction by themselves; use `reading` and `writing`.
    name : str
        What to call it in messages: the path of the file.
    """

    def __init__(self, engine: Engine, name: str) -> None:
        self.engine = engine
        self.name = name
        self._turn = threading.Lock()

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
            If the database stayed locked or cannot take the data now (disk full, I/O error).
        """
        # The lock queues the threads of this process; SQLite itself lets contenders poll, and
        # an unlucky one could starve.
        if not self._turn.acquire(timeout=patience_s):
            raise StoreUnavailableError(f"{self.name}: busy with another write")
        try:
            with self._translated(), self.engine.connect() as connection:
                connection = connection.execution_options(**{_WRITES: True})
                with _busy_timeout(connection, patience_s), connection.begin():
                    yield connection
        finally:
            self._turn.release()

    @contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except PoolTimeoutError as error:
            raise StoreUnavailableError(f"{self.name}: {error}") from error
        except DatabaseError as error:
            # Locked, full, I/O error, damaged: the state of the disk. The other kinds (a broken
            # constraint, a wrong statement) are the caller's.
            if isinstance(error, OperationalError | InternalError) or type(error) is DatabaseError:
                raise StoreUnavailableError(f"{self.name}: {error.orig}") from error
            raise

    def close(self) -> None:
        """Close every connection."""
        self.engine.dispose()


@contextmanager
def _busy_timeout(connection: Connection, patience_s: float) -> Iterator[None]:
    raw: Any = connection.connection.driver_connection
    raw.execute(f"PRAGMA busy_timeout = {round(patience_s * 1000)}")
    try:
        yield
    finally:
        raw.execute(f"PRAGMA busy_timeout = {round(PATIENCE_S * 1000)}")


def open_database(database_url: str, data_dir: Path) -> Database:
    """Open the database, make it when it is new, and bring its tables up to date.

    Parameters
    ----------
    database_url : str
        Empty for the SQLite file of the data directory, or ``sqlite:///PATH``.
    data_dir : pathlib.Path
        Made when it does not exist.

    Raises
    ------
    StoreError
        If the file cannot be used, is not ours or is damaged; one line that names it.
    """
    url = _url(database_url, data_dir)
    path = Path(url.database or "")
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            f"data directory {error.filename}: cannot be made ({error.strerror})"
        ) from error
    engine = _engine(url)
    try:
        with engine.connect() as connection:
            # Readers never wait for the writer; the file remembers it.
            raw: Any = connection.connection.driver_connection
            raw.execute("PRAGMA journal_mode = WAL")
        if not is_current(engine):
            upgrade(engine)
        with engine.connect() as connection:
            connection.execution_options(**{_WRITES: True}).begin().rollback()
    except (DBAPIError, sqlite3.Error) as error:
        engine.dispose()
        cause = error.orig if isinstance(error, DBAPIError) else error
        raise StoreError(f"store {path}: {_explained(cause)}") from error
    except StoreError as error:
        engine.dispose()
        raise StoreError(f"store {path}: {error}") from error
    return Database(engine, str(path))


def _url(database_url: str, data_dir: Path) -> URL:
    if not database_url:
        return URL.create("sqlite", database=str(data_dir / FILE_NAME))
    try:
        url = make_url(database_url)
    except ArgumentError:
        raise StoreError(
            f"service.database_url = {database_url!r}: expected empty or sqlite:///PATH"
        ) from None
    if url.get_backend_name() != "sqlite" or not url.database or url.database == ":memory:":
        shown = url.render_as_string(hide_password=True)
        raise StoreError(f"service.database_url = {shown!r}: expected empty or sqlite:///PATH")
    return url


def _engine(url: URL) -> Engine:
    engine = create_engine(
        url,
        connect_args={"timeout": PATIENCE_S},
        pool_size=8,
        max_overflow=32,
        pool_timeout=PATIENCE_S,
    )

    def prepare(connection: sqlite3.Connection, _entry: ConnectionPoolEntry) -> None:
        # The driver's own idea of when a transaction begins is switched off: see `begin`.
        connection.isolation_level = None
        # A commit is on the disk when it returns: what was acknowledged outlives a power cut.
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = ON")

    def begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get(_WRITES, False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    event.listen(engine, "connect", prepare)
    event.listen(engine, "begin", begin)
    return engine


def _explained(cause: BaseException | None) -> str:
    text = str(cause)
    if "not a database" in text:
        return "not an SQLite database; expected a file made by bearing-twin"
    if "unable to open" in text:
        return "cannot be opened; expected a path that may be written"
    if "readonly" in text:
        return "may not be written"
    return text
