"""Migrations of the database, run from the program: no configuration file is needed."""

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy import Engine, inspect

from service.store.errors import StoreError


def _config() -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent).replace("%", "%%"))
    return config


def is_current(engine: Engine) -> bool:
    """Tell whether the tables are those of this version of the program; only reads.

    Raises
    ------
    StoreError
        If the database belongs to another program or to a newer version of this one.
    """
    scripts = ScriptDirectory.from_config(_config())
    with engine.connect() as connection:
        revision = MigrationContext.configure(connection).get_current_revision()
        if revision is None:
            if inspect(connection).get_table_names():
                raise StoreError("holds the tables of another program")
            return False
    try:
        scripts.get_revision(revision)
    except CommandError:
        raise StoreError(
            f"its tables ({revision}) are those of a newer version of bearing-twin"
        ) from None
    return revision == scripts.get_current_head()


def upgrade(engine: Engine, revision: str = "head") -> None:
    """Bring the tables up to date in one transaction.

    Two programs may start at once: the second waits for the first and finds nothing to do.

    Parameters
    ----------
    engine : sqlalchemy.Engine
        Engine of the database.
    revision : str
        Up to which migration; all of them by default.
    """
    config = _config()
    with engine.connect() as connection:
        writer = connection.execution_options(bearing_twin_writes=True)
        with writer.begin():
            config.attributes["connection"] = writer
            command.upgrade(config, revision)
