"""Which database a URL names."""

from pathlib import Path

from sqlalchemy.engine import URL

from service.files import make_private_folder
from service.store.addresses import parse_address
from service.store.database import Database
from service.store.errors import opening_error
from service.store.postgresql import open_postgresql
from service.store.sqlite import open_sqlite

FILE_NAME = "bearing-twin.db"


def open_database(database_url: str, data_dir: Path, *, migrate: bool, run: str = "") -> Database:
    """Open the database; see `Store.open`.

    Raises
    ------
    StoreError
        If it cannot be used; one line that names it.
    """
    url = database_address(database_url, data_dir)
    try:
        make_private_folder(data_dir)
    except OSError as error:
        raise opening_error(
            f"data directory {error.filename}: cannot be made ({error.strerror})", error
        ) from error
    if url.get_backend_name() == "postgresql":
        return open_postgresql(url, migrate=migrate, run=run)
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
    return parse_address(database_url)
