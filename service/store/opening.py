"""Which database a URL names."""

from pathlib import Path

from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError

from service.store.database import Database
from service.store.errors import StoreError, opening_error
from service.store.postgresql import open_postgresql
from service.store.sqlite import open_sqlite

FILE_NAME = "bearing-twin.db"

_EXPECTED = "empty, sqlite:///PATH or postgresql://USER:PASSWORD@HOST/DATABASE"


def open_database(database_url: str, data_dir: Path, *, migrate: bool) -> Database:
    """Open the database; see `Store.open`.

    Raises
    ------
    StoreError
        If it cannot be used; one line that names it.
    """
    url = database_address(database_url, data_dir)
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise opening_error(
            f"data directory {error.filename}: cannot be made ({error.strerror})", error
        ) from error
    if url.get_backend_name() == "postgresql":
        return open_postgresql(url, migrate=migrate)
    return open_sqlite(url)


def database_address(database_url: str, data_dir: Path) -> URL:
    """Check and complete the configured URL of the database.

    Raises
    ------
    StoreError
        If it is none of the kinds that there are; one line without its password.
    """
    if not database_url:
        return URL.create("sqlite", database=str(data_dir / FILE_NAME))
    try:
        url = make_url(database_url)
    except ArgumentError:
        raise StoreError(f"service.database_url = {database_url!r}: expected {_EXPECTED}") from None
    backend, shown = url.get_backend_name(), url.render_as_string(hide_password=True)
    in_memory = backend == "sqlite" and (not url.database or url.database == ":memory:")
    driver = url.drivername.partition("+")[2]
    if backend not in ("sqlite", "postgresql") or in_memory or driver not in ("", "psycopg"):
        raise StoreError(f"service.database_url = {shown!r}: expected {_EXPECTED}")
    return url
