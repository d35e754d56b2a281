"""Which database a URL names."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy.engine import URL

from service.files import make_private_folder
from service.store.addresses import parse_address
from service.store.database import Database
from service.store.errors import opening_error
from service.store.locking import DataDirectoryLock, lock_sqlite_file
from service.store.sqlite import open_sqlite

if TYPE_CHECKING:
    from service.store.database_lock import DatabaseLock

FILE_NAME = "bearing-twin.db"


def open_database(database_url: str, data_dir: Path, *, migrate: bool, run: str = "") -> Database:
    """Open the database; see `Store.open`.

    Raises `StoreError` if it cannot be used; one line that names it.
    """
    url = database_address(database_url, data_dir)
    try:
        make_private_folder(data_dir)
    except OSError as error:
        raise opening_error(
            f"data directory {error.filename}: cannot be made ({error.strerror})", error
        ) from error
    if url.get_backend_name() == "postgresql":
        # Its driver is loaded only where it is needed.
        from service.store.postgresql import open_postgresql

        return open_postgresql(url, migrate=migrate, run=run)
    return open_sqlite(url)


def lock_database(
    database_url: str, data_dir: Path, on_lost: Callable[[], object]
) -> "DatabaseLock | DataDirectoryLock":
    """Take a database for one service: see `DatabaseLock`, and `lock_sqlite_file`."""
    url = database_address(database_url, data_dir)
    if url.get_backend_name() == "postgresql":
        from service.store.database_lock import DatabaseLock

        return DatabaseLock(url, on_lost)
    return lock_sqlite_file(Path(url.database or ""))


def database_address(database_url: str, data_dir: Path) -> URL:
    """Check and complete the configured URL of the database.

    Raises `StoreError` if it is none of the kinds that there are; one line without its password.
    """
    if not database_url:
        return URL.create("sqlite", database=str(data_dir / FILE_NAME))
    return parse_address(database_url)
