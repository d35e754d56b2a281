"""Copies of an SQLite store that are checked."""

import contextlib
import os
import sqlite3
from pathlib import Path

from service.files import new_part
from service.store.errors import StoreError
from service.store.sqlite_file import connect_file


def copy_sqlite(source: Path, target: Path) -> dict[str, int]:
    """Copy a store, also while it is written, and check the copy; return its rows by table.

    The copy is that of one moment. It takes its place when it is complete, whole, and has as many
    rows in each table as the source at that moment. Raises `StoreError` if the source is damaged,
    or the copy cannot be made or is not whole.
    """
    try:
        with new_part(target) as part:
            with (
                contextlib.closing(connect_file(source)) as old,
                contextlib.closing(connect_file(part)) as new,
            ):
                old.execute("BEGIN")  # what is counted is what is copied
                counts = table_counts(old)
                old.backup(new)
                old.execute("ROLLBACK")
                new.execute("PRAGMA journal_mode = DELETE")
                if problems := check_sqlite(new):
                    raise StoreError(f"copy of {source}: not whole ({problems})")
                copied = table_counts(new)
            if copied != counts:
                raise StoreError(f"copy of {source}: has {copied} rows, expected {counts}")
            with part.open("rb") as file:
                os.fsync(file.fileno())
            part.replace(target)
    except (sqlite3.Error, OSError) as error:
        raise StoreError(f"copy of {source} to {target}: {error}") from error
    return counts


def check_sqlite(connection: sqlite3.Connection) -> str:
    """Say what is wrong with a database in one line; empty when it is whole."""
    lines = [str(line) for (line,) in connection.execute("PRAGMA integrity_check(3)")]
    return "" if lines == ["ok"] else "; ".join(" ".join(line.split()) for line in lines)


def table_counts(connection: sqlite3.Connection) -> dict[str, int]:
    """Rows of every table."""
    names = connection.execute(
        "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite%' "
        "ORDER BY name"
    ).fetchall()
    return {
        name: int(connection.execute(f'SELECT COUNT(*) FROM "{name}"').fetchone()[0])
        for (name,) in names
    }
