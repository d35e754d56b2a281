"""Migrations of the database, run from the program: no configuration file is needed.

Those of a feature lie in its folder, in ``migrations``; all of them are one row by number.
"""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import Connection, Engine, inspect, text

from service.feature_folders import feature_paths
from service.store.errors import StoreError
from service.store.identity import CREATED, renew
from service.store.tables import all_tables

if TYPE_CHECKING:  # Alembic takes a while to load, and only an older database needs it.
    from alembic.config import Config

_VERSIONS = Path(__file__).parent / "versions"
_VERSION_TABLE = "alembic_version"


@cache
def last_revision() -> str:
    """The last migration, which makes the tables that this version of the program expects."""
    return max(file.name.partition("_")[0] for file in _files("[0-9]*_*.py"))


def _folders() -> list[Path]:
    return [_VERSIONS, *feature_paths("migrations")]


def _files(pattern: str) -> list[Path]:
    return [file for folder in _folders() for file in folder.glob(pattern)]


def is_current(engine: Engine) -> bool:
    """Whether the tables are those of this version of the program; only reads.

    Raises `StoreError` if the database belongs to another program or to a newer version of this
    one.
    """
    with engine.connect() as connection:
        revision = _revision(connection)
        if revision is None and inspect(connection).get_table_names():
            raise StoreError("holds the tables of another program")
    if revision not in (None, last_revision()) and not _files(f"{revision}_*.py"):
        raise StoreError(f"its tables ({revision}) are those of a newer version of bearing-twin")
    return revision == last_revision()


def upgrade(engine: Engine, revision: str = "head") -> None:
    """Bring the tables up to date in one transaction.

    Two programs may start at once: the second waits for the first and finds nothing to do.

    - ``revision``: up to which migration; all of them by default.
    """
    from alembic import command

    config = _config()
    with engine.connect() as connection:
        writer = connection.execution_options(bearing_twin_writes=True)
        with writer.begin():
            config.attributes["connection"] = writer
            command.upgrade(config, revision)


def make_tables(engine: Engine) -> None:
    """Make the tables of a new database as all migrations together would, in one transaction."""
    with engine.connect() as connection:
        writer = connection.execution_options(bearing_twin_writes=True)
        with writer.begin():
            if inspect(writer).has_table(_VERSION_TABLE):
                return  # by another program that started at the same time
            all_tables().create_all(writer)
            renew(writer, CREATED)
            writer.execute(
                text(
                    f"CREATE TABLE {_VERSION_TABLE} (version_num VARCHAR(32) NOT NULL, "
                    f"CONSTRAINT {_VERSION_TABLE}_pkc PRIMARY KEY (version_num))"
                )
            )
            writer.execute(
                text(f"INSERT INTO {_VERSION_TABLE} (version_num) VALUES (:revision)"),
                {"revision": last_revision()},
            )


def _config() -> "Config":
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent).replace("%", "%%"))
    config.set_main_option("path_separator", "newline")
    versions = "\n".join(str(folder) for folder in _folders())
    config.set_main_option("version_locations", versions.replace("%", "%%"))
    return config


def _revision(connection: Connection) -> str | None:
    """The migration that the tables are those of; None without tables of ours."""
    if not inspect(connection).has_table(_VERSION_TABLE):
        return None
    revision: str | None = connection.scalar(text(f"SELECT version_num FROM {_VERSION_TABLE}"))
    return revision
