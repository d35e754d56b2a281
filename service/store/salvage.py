"""What can be read of a damaged SQLite store, into a new file."""

import contextlib
import json
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import JSON, Boolean, Column, Double, Integer, LargeBinary, Table
from sqlalchemy.engine import URL

from service.clock import HOUR_US
from service.store import packed, rollup_blocks
from service.store.blocks import Block, BlockDamagedError, is_damaged, unpack
from service.store.errors import StoreError
from service.store.pages import PageRow, log_rows, page_rows
from service.store.queue_file import set_aside
from service.store.rollup_blocks import SPANS_US
from service.store.sqlite import open_sqlite
from service.store.sqlite_file import connect_file
from service.store.tables import all_tables

#: Rows of these tables come from their trees alone: a page that is not in use any more may hold a
#: key as it was before it was revoked; what is stale is found again.
_FROM_TREES_ONLY = {"api_keys", "browser_sessions", "stale_rollups", "store_identity"}
#: Columns at the end of a table that rows from before a migration do not have.
_LATER_COLUMNS = {"samples": 1}
_PORTION = 10_000


@dataclass(frozen=True, slots=True)
class Salvaged:
    """What became of a damaged store.

    - ``problem``: what SQLite says of it.
    - ``rows``: rows in the new file by table.
    - ``unnamed_channels``: channels whose name is lost: they are called ``channel-N`` of the asset
      ``salvaged``.
    """

    kept_as: Path
    problem: str
    rows: dict[str, int]
    unnamed_channels: int


def damage_of(path: Path) -> str | None:
    """Say what is wrong with an SQLite file, one line; None when it is whole.

    It reads the whole file, which takes a while for a large one. Raises `StoreError` if the file
    cannot be opened.
    """
    if not path.is_file():
        raise StoreError(f"store {path}: there is no such file")
    try:
        with contextlib.closing(connect_file(path, timeout_s=30.0)) as connection:
            found = connection.execute("PRAGMA quick_check(3)").fetchall()
    except sqlite3.DatabaseError as error:
        return " ".join(str(error).split())
    lines = [" ".join(str(line).split()) for (line,) in found]
    return None if lines == ["ok"] else "; ".join(lines)


def salvage_store(path: Path, problem: str) -> Salvaged:
    """Put what can be read of a damaged store into a new file in its place; keep the damaged one.

    No one else may have the file open. Raises `StoreError` if the new file cannot be made.

    - ``problem``: what is wrong with it, see `damage_of`.
    """
    new = path.with_name(f"{path.stem}-salvaged{path.suffix}")
    for companion in ("", "-wal", "-shm"):
        new.with_name(new.name + companion).unlink(missing_ok=True)
    open_sqlite(URL.create("sqlite", database=str(new))).close()
    try:
        with contextlib.closing(connect_file(new)) as target:
            target.execute("PRAGMA foreign_keys = OFF")
            target.execute("BEGIN")
            _copy_trees(path, target)
            _copy_pages(path, target)
            unnamed = _complete(target)
            target.execute("COMMIT")
            rows = {
                table.name: int(target.execute(f"SELECT COUNT(*) FROM {table.name}").fetchone()[0])
                for table in all_tables().sorted_tables
            }
    except (sqlite3.Error, OSError) as error:
        raise StoreError(f"store {new}: cannot be written ({error})") from error
    kept_as = set_aside(path)
    new.replace(path)
    return Salvaged(kept_as, problem, rows, unnamed)


def _copy_trees(path: Path, target: sqlite3.Connection) -> None:
    """Copy what SQLite itself finds, up to the damage."""
    try:
        source = connect_file(path, timeout_s=1.0)
    except sqlite3.Error:
        return
    with contextlib.closing(source):
        for table in all_tables().sorted_tables:
            names = [column.name for column in table.columns]
            with contextlib.suppress(sqlite3.Error):  # an earlier version may have made the file
                made = {row[1] for row in source.execute(f"PRAGMA table_info({table.name})")}
                names = [name for name in names if name in made]
            columns = ", ".join(f'"{name}"' for name in names)
            queries = [f"SELECT {columns} FROM {table.name}"]
            if table.name == "channels":  # its index holds all of it once more
                index = "channels INDEXED BY uq_channels_asset_name"
                queries.append(f"SELECT {columns} FROM {index}")
            for query in queries:
                with contextlib.suppress(sqlite3.Error):
                    cursor = source.execute(query)
                    while rows := cursor.fetchmany(100):
                        _insert(target, table, names, rows)


def _copy_pages(path: Path, target: sqlite3.Connection) -> None:
    """Copy what no tree leads to any more, table by table, as its rows look."""
    shapes = [
        _Shape(table, target)
        for table in all_tables().sorted_tables
        if table.name not in _FROM_TREES_ONLY
    ]
    waiting: dict[str, list[tuple[Any, ...]]] = {shape.table.name: [] for shape in shapes}

    def flush(shape: "_Shape", least: int) -> None:
        rows = waiting[shape.table.name]
        if len(rows) >= least:
            _insert(target, shape.table, shape.columns, rows)
            rows.clear()

    for row in _all_rows(path):
        for shape in shapes:
            values = shape.row(row)
            if values is not None:
                waiting[shape.table.name].append(values)
                flush(shape, _PORTION)
                break
    for shape in shapes:
        flush(shape, 1)


def _all_rows(path: Path) -> Iterator[PageRow]:
    log = path.with_name(f"{path.name}-wal")
    if log.exists():
        yield from log_rows(log)
    yield from page_rows(path)


class _Shape:
    """What rows of a table look like in a page."""

    def __init__(self, table: Table, target: sqlite3.Connection) -> None:
        self.table = table
        # In the order in which the file has them, which is that of their making.
        made = target.execute(f"PRAGMA table_info({table.name})").fetchall()
        self.columns = [str(row[1]) for row in made]
        columns = [table.columns[name] for name in self.columns]
        sql = target.execute("SELECT sql FROM sqlite_master WHERE name = ?", (table.name,))
        self._has_rowid = "WITHOUT ROWID" not in str(sql.fetchone()[0])
        self._number = None
        if self._has_rowid and len(table.primary_key.columns) == 1:
            (key,) = table.primary_key.columns
            if isinstance(key.type, Integer):
                self._number = self.columns.index(key.name)
        self._fits = [_fits(column) for column in columns]

    def row(self, found: PageRow) -> tuple[Any, ...] | None:
        """Give the values of a row; None if it is none of this table."""
        missing = len(self.columns) - len(found.values)
        if (found.rowid is not None) != self._has_rowid or not (
            0 <= missing <= _LATER_COLUMNS.get(self.table.name, 0)
        ):
            return None
        values: list[Any] = [*found.values, *[None] * missing]
        if self._number is not None:
            if values[self._number] is not None:
                return None
            values[self._number] = found.rowid
        if not all(fits(value) for fits, value in zip(self._fits, values, strict=True)):
            return None
        return tuple(values) if _makes_sense(self.table.name, values) else None


def _fits(column: "Column[Any]") -> Callable[[object], bool]:
    """Give the values that a column can have."""
    kind = column.type

    def fits(value: object) -> bool:
        if value is None:
            return bool(column.nullable)
        if isinstance(kind, Boolean):
            return value in (0, 1)
        if isinstance(kind, Integer):
            return isinstance(value, int)
        if isinstance(kind, Double):
            return isinstance(value, int | float)
        if isinstance(kind, LargeBinary):
            return isinstance(value, bytes)
        if not isinstance(value, str):
            return False
        return not isinstance(kind, JSON) or _is_json(value)

    return fits


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except ValueError:
        return False
    return True


def _makes_sense(table: str, values: list[Any]) -> bool:
    """Refuse what has the right kinds of values and still is no row of a table."""
    if table == "samples":
        channel_id, time_us, _, quality, received_us = values
        return bool(
            channel_id > 0 and time_us >= 0 and 0 <= quality <= 255 and (received_us or 0) >= 0
        )
    if table == "packed_hours":
        channel_id, hour_us, _, position, first_us, last_us, count = values
        return bool(
            channel_id > 0
            and 0 <= hour_us <= first_us <= last_us < hour_us + HOUR_US
            and position >= 0
            and count > 0
        )
    if table == "rollup_blocks":
        channel_id, resolution_s, begin_us, codec, crc, data = values
        return bool(
            channel_id > 0
            and begin_us >= 0
            and resolution_s in SPANS_US
            and not is_damaged(Block(codec, crc, data))
        )
    if table in ("retention_marks", "deliveries"):
        return (values[0] in ("process", "wall")) == (table == "retention_marks")
    return True


def _insert(
    target: sqlite3.Connection, table: Table, columns: list[str], rows: Iterable[tuple[Any, ...]]
) -> None:
    names = ", ".join(f'"{name}"' for name in columns)
    places = ", ".join("?" * len(columns))
    target.executemany(
        f"INSERT OR IGNORE INTO {table.name} ({names}) VALUES ({places})",
        rows,
    )


def _join_hours(target: sqlite3.Connection) -> None:
    """Make rows of hours of which there are rows and a block.

    A free page may still hold rows from before an hour was packed, or a block from before the hour
    got another sample.
    """
    both = target.execute(
        "SELECT h.channel_id, h.hour_us, h.position, b.codec, b.crc, b.data "
        "FROM packed_hours h JOIN sample_blocks b ON b.id = h.block_id "
        "WHERE EXISTS (SELECT 1 FROM samples s WHERE s.channel_id = h.channel_id "
        f"AND s.time_us >= h.hour_us AND s.time_us < h.hour_us + {HOUR_US})"
    ).fetchall()
    for channel_id, hour_us, position, *block in both:
        try:
            samples = unpack(Block(*block), position)
        except (BlockDamagedError, StoreError):
            continue
        target.executemany(
            "INSERT OR IGNORE INTO samples VALUES (?, ?, ?, ?, ?)",
            [(channel_id, *row) for row in packed.rows(samples)],
        )
        target.execute(
            "DELETE FROM packed_hours WHERE channel_id = ? AND hour_us = ?", (channel_id, hour_us)
        )
    target.execute("DELETE FROM sample_blocks WHERE id NOT IN (SELECT block_id FROM packed_hours)")


def _leave_packed_rollups(target: sqlite3.Connection) -> None:
    """Remove damaged blocks of rollups, and rows of what is in a whole one.

    A free page may still hold the rows that an earlier version left.
    """
    query = "SELECT channel_id, resolution_s, begin_us, codec, crc, data FROM rollup_blocks"
    for *key, codec, crc, data in target.execute(query).fetchall():
        channel_id, resolution_s, begin_us = key
        try:
            found = rollup_blocks.unpack(Block(codec, crc, data), resolution_s, begin_us)
        except (BlockDamagedError, StoreError):
            where = "channel_id = ? AND resolution_s = ? AND begin_us = ?"
            target.execute(f"DELETE FROM rollup_blocks WHERE {where}", key)
            continue
        for row_s in (1,) if resolution_s == 1 else (60, 600):
            row_us = row_s * 1_000_000
            target.executemany(
                "DELETE FROM rollups WHERE channel_id = ? AND resolution_s = ? AND time_us = ?",
                [
                    (channel_id, row_s, time_us)
                    for time_us in sorted({one - one % row_us for one in found.times_us.tolist()})
                ],
            )


def _complete(target: sqlite3.Connection) -> int:
    """Make up for what is missing; returns how many channels have lost their names."""
    unnamed = target.execute(
        "INSERT INTO channels (id, asset, name) "
        "SELECT channel_id, 'salvaged', 'channel-' || channel_id FROM "
        "(SELECT channel_id FROM samples UNION SELECT channel_id FROM packed_hours "
        "UNION SELECT channel_id FROM rollup_blocks) "
        "WHERE channel_id NOT IN (SELECT id FROM channels)"
    ).rowcount
    blocks = target.execute("SELECT id, codec, crc, data FROM sample_blocks")
    broken = [(number,) for number, *block in blocks if is_damaged(Block(*block))]
    target.executemany("DELETE FROM sample_blocks WHERE id = ?", broken)
    target.execute("DELETE FROM packed_hours WHERE block_id NOT IN (SELECT id FROM sample_blocks)")
    _join_hours(target)
    _leave_packed_rollups(target)
    # Rollups are computed again where there are samples.
    target.execute(
        "INSERT OR IGNORE INTO stale_rollups (channel_id, hour_us) "
        f"SELECT channel_id, time_us - time_us % {HOUR_US} FROM samples "
        "UNION SELECT channel_id, hour_us FROM packed_hours"
    )
    for table, column, other in (
        ("alarm_journal", "alarm_id", "alarms"),
        ("browser_sessions", "key_id", "api_keys"),
        ("rollups", "channel_id", "channels"),
    ):
        missing = f"{column} IS NOT NULL AND {column} NOT IN (SELECT id FROM {other})"
        if table == "alarm_journal":  # the line stays, for what it says
            target.execute(f"UPDATE {table} SET {column} = NULL WHERE {missing}")
        else:
            target.execute(f"DELETE FROM {table} WHERE {missing}")
    return unnamed
