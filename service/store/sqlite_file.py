"""How SQLite files of a store are opened, and what may be in one."""

import re
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from sqlalchemy import create_engine

from service.store.migrations import make_tables

#: The file may come from another place: an expression in its tables calls only harmless functions.
GUARD = "PRAGMA trusted_schema = OFF"
#: How SQLite notes all that a store of any version was made of; the rest runs by itself.
_KNOWN = (
    "CREATE TABLE ",
    "CREATE INDEX ",
    "CREATE UNIQUE INDEX ",
    "CREATE TRIGGER audit_no_update BEFORE UPDATE ON audit ",
    "CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit ",
)
#: What ``ANALYZE`` makes.
_STATISTICS = {
    "CREATE TABLE sqlite_stat1(tbl,idx,stat)",
    "CREATE TABLE sqlite_stat4(tbl,idx,neq,nlt,ndlt,sample)",
}


def connect_file(
    path: Path, *, read_only: bool = False, timeout_s: float = 5.0
) -> sqlite3.Connection:
    """Open a file without trust in its schema; each statement is a transaction of its own."""
    name = f"{path.resolve().as_uri()}?mode=ro" if read_only else str(path)
    connection = sqlite3.connect(name, timeout=timeout_s, isolation_level=None, uri=read_only)
    connection.execute(GUARD)
    return connection


def find_program(connection: sqlite3.Connection) -> str:
    """Name a view, a virtual table or a trigger that no version of ours makes; empty without.

    To be asked before anything is written to a file from another place.
    """
    for kind, name, sql in _objects(connection):
        if not sql.startswith(_KNOWN):
            return _foreign(kind, name)
    return ""


def complete_schema(connection: sqlite3.Connection) -> str:
    """Compare a file with a new store, and make the indexes and triggers that it lacks.

    Returns what else is different, in one line; empty when nothing is. A table that was upgraded
    has another text than a new one: quotes, spaces, and the order of its columns and constraints.
    """
    missing = _own()
    for kind, name, sql in _objects(connection):
        own = missing.pop((kind, name), None)
        if own is None:
            return _foreign(kind, name)
        if sql != own and (kind != "table" or _parts(sql) != _parts(own)):
            return f"{_label(kind, name)} is not as bearing-twin makes it"
    for kind, name in missing:
        if kind == "table":
            return f"{_label(kind, name)} is missing"
    for sql in missing.values():
        connection.execute(sql)
    return ""


def _own() -> dict[tuple[str, str], str]:
    engine = create_engine("sqlite://")
    make_tables(engine)
    with engine.connect() as connection:
        raw = connection.connection.driver_connection
        assert isinstance(raw, sqlite3.Connection)  # noqa: S101 - asked for
        found = {(kind, name): sql for kind, name, sql in _objects(raw)}
    engine.dispose()
    return found


def _objects(connection: sqlite3.Connection) -> Iterator[tuple[str, str, str]]:
    # What has no text is the index of a constraint, which is in the text of its table.
    query = "SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY rowid"
    for row in connection.execute(query).fetchall():
        kind, name, sql = map(str, row)
        if sql not in _STATISTICS:
            yield kind, name, sql


def _parts(sql: str) -> tuple[str, list[str], str]:
    """Split the text of a table into head, columns with constraints in any order, and tail."""
    text = re.sub(r'^CREATE TABLE "(\w+)"', r"CREATE TABLE \1", " ".join(sql.split()))
    head, _, rest = text.partition("(")
    body, _, tail = rest.rpartition(")")
    parts = re.split(r",(?![^()]*\))", body)  # no comma within parentheses
    return head.strip(), sorted(part.strip() for part in parts), tail.strip()


def _foreign(kind: str, name: str) -> str:
    return f"{_label(kind, name)} is not one of bearing-twin's"


def _label(kind: str, name: str) -> str:
    return f"{kind if kind.isalpha() else 'entry'} {name[:60]!r}"
