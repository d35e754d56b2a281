"""PostgreSQL: the same tables, with the samples in partitions of about a month."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import psycopg
from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError, IntegrityError, OperationalError

from adapters.samples import Quality
from service.store.addresses import shown
from service.store.database import (
    PATIENCE_S,
    WRITES,
    WRITES_SAMPLES,
    Database,
    Dialect,
    Hours,
    SampleColumns,
    SampleValues,
    require_alone,
)
from service.store.errors import StoreError
from service.store.migrations import is_current, upgrade
from service.store.postgresql_columns import (
    COPY_HEADER,
    COPY_TRAILER,
    ROW,
    insert_rollups,
    read_samples,
)
from service.store.postgresql_connection import (
    ANSWER_S,
    CONNECT_ARGS,
    CONNECT_S,
    PatientConnection,
    connection_error,
)

#: Samples of one partition: 2^41 microseconds, 25.5 days. Packed hours leave them.
PARTITION_US = 2**41

#: Wall seconds beyond the patience of a transaction in which the server must answer.
_ANSWER_MARGIN_S = 2.0
_IDLE_MS = 15_000
_PATIENCE = "bearing_twin_patience_s"
_PARTITIONS = "bearing_twin_partitions"
#: Number of the advisory lock that a writing transaction holds; any that no one else uses.
_WRITERS_LOCK = 0x42545772
_INCOMING = """
CREATE TEMPORARY TABLE IF NOT EXISTS incoming_samples
(channel_id integer, time_us bigint, value double precision, quality smallint, received_us bigint)
ON COMMIT DELETE ROWS
"""
_COPY = "COPY {} (channel_id, time_us, value, quality, received_us) FROM STDIN (FORMAT BINARY)"
_LENGTHS = {"channel_id": 4, "time_us": 8, "value": 8, "quality": 2, "received_us": 8}
#: Rows of which nothing is missing, the value, the received time, or both.
_ROWS = tuple(
    np.dtype([(name, ROW[name]) for name in ROW.names or () if name not in missing])
    for missing in ((), ("value",), ("received_us",), ("value", "received_us"))
)
#: See the same statement for SQLite.
_UPSERT = f"""
INSERT INTO samples (channel_id, time_us, value, quality, received_us)
SELECT channel_id, time_us, value, quality, received_us FROM incoming_samples
ON CONFLICT (channel_id, time_us) DO UPDATE
SET value = excluded.value, quality = excluded.quality, received_us = excluded.received_us
WHERE samples.quality < {Quality.GOOD:d} AND excluded.quality >= {Quality.GOOD:d}
"""
#: A note that the rollups of an hour of a channel are stale is also the lock of its samples: who
#: adds to them, and who packs them, writes it first, and finds it again or waits.
_LOCK_HOURS = """
INSERT INTO stale_rollups (channel_id, hour_us) SELECT * FROM unnest(%s::integer[], %s::bigint[])
ON CONFLICT (channel_id, hour_us) DO UPDATE SET hour_us = excluded.hour_us WHERE false
RETURNING channel_id, hour_us
"""
_UNMARK = """
DELETE FROM stale_rollups USING unnest(%s::integer[], %s::bigint[]) AS one (channel_id, hour_us)
WHERE stale_rollups.channel_id = one.channel_id AND stale_rollups.hour_us = one.hour_us
"""


def open_postgresql(url: URL, *, migrate: bool, run: str = "") -> Database:
    """Connect to the database.

    Raises `StoreError` if there is no connection, or the tables are not those of this version; one
    line. Raises `StoreUnavailableError` if that may pass: the server is not up yet, or
    does not answer.

    - ``migrate``: bring the tables up to date first; otherwise they must be.
    - ``run``: what the server calls the connections; empty for the name of the product.
    """
    name = f"service.database_url = {shown(url)!r}"
    # A migration may take its time.
    engine = _engine(url, None if migrate else ANSWER_S, run)
    try:
        if not is_current(engine):
            if not migrate:
                raise StoreError(
                    "its tables are not those of this version; run 'bearing-twin db upgrade' first"
                )
            upgrade(engine)
    except DBAPIError as error:
        engine.dispose()
        raise connection_error(name, error.orig, url) from error
    except StoreError as error:
        engine.dispose()
        raise type(error)(f"{name}: {error}") from error
    dialect = Dialect(
        _upsert_samples, read_samples, insert_rollups, _lock_hours, _mark_stale, _with_patience
    )
    return Database(engine, shown(url), dialect)


def _lock_hours(connection: Connection, hours: Hours) -> Hours:
    if not hours:
        return ()
    # In one order: two that want the same ones cannot wait for each other.
    channel_ids, hours_us = zip(*sorted(hours), strict=True)
    rows = connection.exec_driver_sql(_LOCK_HOURS, (list(channel_ids), list(hours_us)))
    return {(channel_id, hour_us) for channel_id, hour_us in rows}


def _mark_stale(connection: Connection, hours: Hours, locked: Hours) -> None:
    """Only take back what is not stale: what is locked is marked by that."""
    needless = set(locked).difference(hours)
    if needless:
        channel_ids, hours_us = zip(*needless, strict=True)
        connection.exec_driver_sql(_UNMARK, (list(channel_ids), list(hours_us)))


def _upsert_samples(connection: Connection, columns: SampleColumns) -> int:
    # Of the server that this connection leads to: the next one may lead to another.
    partitions: set[int] = connection.info.setdefault(_PARTITIONS, set())
    times_us = columns.times_us
    first, last = min(times_us) // PARTITION_US, max(times_us) // PARTITION_US
    needed = {first} if first == last else {time_us // PARTITION_US for time_us in times_us}
    for number in needed - partitions:
        if _has_partition(connection, number):
            partitions.add(number)
        else:  # not remembered until it is found: this transaction may be rolled back
            _make_partition(connection, number)
    cursor: Any = connection.connection.cursor()
    try:
        # Nearly always all are new. A batch with some that are not is sent a second time.
        cursor.execute("SAVEPOINT copied")
        try:
            _copy(cursor, "samples", columns)
        except psycopg.errors.UniqueViolation:
            cursor.execute("ROLLBACK TO SAVEPOINT copied")
        else:
            cursor.execute("RELEASE SAVEPOINT copied")
            return len(times_us)
        once, replaced = _each_once(columns)
        twice = sum(not _is_stored(connection, key) for key in replaced)
        cursor.execute(_INCOMING)
        _copy(cursor, "incoming_samples", once)
        # Row by row, a bad value and then a good one of a new time are two changes.
        cursor.execute(_UPSERT)
        return int(cursor.rowcount) + twice
    except (psycopg.OperationalError, psycopg.InternalError) as error:
        raise OperationalError(_COPY, None, error) from error  # as it comes from other statements
    except psycopg.IntegrityError as error:
        raise IntegrityError(_COPY, None, error) from error
    finally:
        cursor.close()


def _copy(cursor: Any, table: str, columns: SampleColumns) -> None:
    with cursor.copy(_COPY.format(table)) as copy:
        copy.write(_packed(columns))


def _packed(columns: SampleColumns) -> bytes:
    """Rows in the binary format of COPY; the shorter ones, of which something is missing, last."""
    unknown = np.zeros(len(columns.times_us), bool)
    if None in columns.received_us:  # only when rows of an earlier version come back from a block
        unknown |= [received_us is None for received_us in columns.received_us]
        columns = columns._replace(received_us=[time_us or 0 for time_us in columns.received_us])
    arrays = {
        name: np.array(column, dtype=ROW[name])  # None becomes not a number
        for name, column in zip(_LENGTHS, columns, strict=True)
    }
    # Channel by channel, each in the order in which it came: next to each other in the index.
    order = np.argsort(arrays["channel_id"], kind="stable")
    arrays = {name: array[order] for name, array in arrays.items()}
    kinds = np.isnan(arrays["value"]) + 2 * unknown[order]
    parts = [COPY_HEADER]
    for kind, dtype in enumerate(_ROWS):
        chosen = kinds == kind
        rows = np.empty(np.count_nonzero(chosen), dtype)
        rows["fields"] = len(arrays)
        for name, array in arrays.items():
            rows[f"{name}_length"] = _LENGTHS[name]
            if name in (dtype.names or ()):
                rows[name] = array[chosen]
            else:
                rows[f"{name}_length"] = -1
        parts.append(rows.tobytes())
    return b"".join((*parts, COPY_TRAILER))


def _is_stored(connection: Connection, key: tuple[int, int]) -> bool:
    query = "SELECT 1 FROM samples WHERE channel_id = %s AND time_us = %s"
    return connection.exec_driver_sql(query, key).scalar() is not None


def _each_once(
    columns: SampleColumns,
) -> tuple[SampleColumns, set[tuple[int, int]]]:
    """Rows of which no two have the same key, as one statement may not touch a row twice.

    Also the keys whose bad or uncertain row gave way to a good one.
    """
    kept: dict[tuple[int, int], SampleValues] = {}
    replaced = set()
    for row in zip(*columns, strict=True):
        key = row[0], row[1]
        before = kept.setdefault(key, row)
        if before[3] < Quality.GOOD <= row[3]:
            kept[key] = row
            replaced.add(key)
    return SampleColumns(*zip(*kept.values(), strict=True)), replaced


def _has_partition(connection: Connection, number: int) -> bool:
    query = "SELECT to_regclass(%s)"
    return connection.exec_driver_sql(query, (f"samples_p{number}",)).scalar() is not None


def _make_partition(connection: Connection, number: int) -> None:
    require_alone(connection)  # it keeps everyone else from the table
    first_us, end_us = number * PARTITION_US, (number + 1) * PARTITION_US
    name = f"samples_p{number}"
    connection.exec_driver_sql(
        f"CREATE TABLE IF NOT EXISTS {name} PARTITION OF samples "
        f"FOR VALUES FROM ({first_us}) TO ({end_us})"
    )
    # Samples come nearly in order of time, so a BRIN index of some pages finds any span of it.
    connection.exec_driver_sql(
        f"CREATE INDEX IF NOT EXISTS ix_{name}_time_us ON {name} USING brin (time_us)"
    )


@contextmanager
def _with_patience(connection: Connection, patience_s: float) -> Iterator[None]:
    connection.info[_PATIENCE] = patience_s
    try:
        yield
    finally:
        connection.info.pop(_PATIENCE, None)


def _engine(url: URL, answer_s: float | None, run: str) -> Engine:
    engine = create_engine(
        url.set(drivername="postgresql+psycopg"),
        connect_args=CONNECT_ARGS | ({"application_name": run} if run else {}),
        pool_size=8,
        max_overflow=16,
        pool_timeout=PATIENCE_S,
        # A server that was restarted costs a new connection, not an error.
        pool_pre_ping=True,
    )

    def connect(_dialect: Any, _record: Any, arguments: Any, options: Any) -> PatientConnection:
        return PatientConnection.connect(*arguments, **options)

    def begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get(WRITES, False)
        patience_s = connection.info.get(_PATIENCE, PATIENCE_S)
        limit_s = answer_s
        if writes and limit_s is not None:
            limit_s = min(limit_s, patience_s + _ANSWER_MARGIN_S)
        raw: Any = connection.connection.driver_connection
        raw.answer_s = limit_s
        # A server that is only slow ends what no caller waits for any more.
        limit_ms = 0 if limit_s is None else round(limit_s * 1000)
        if writes:
            connection.exec_driver_sql(
                f"SET LOCAL lock_timeout = {round(patience_s * 1000)};"
                # A process that is stopped in the middle must not hold up the others.
                f"SET LOCAL idle_in_transaction_session_timeout = {_IDLE_MS};"
                f"SET LOCAL statement_timeout = {limit_ms}"
            )
            # Writers of all programs take turns, as with SQLite: what one reads before it writes
            # is still true when it writes. Those of samples share a turn.
            samples = connection.get_execution_options().get(WRITES_SAMPLES, False)
            lock = "pg_advisory_xact_lock_shared" if samples else "pg_advisory_xact_lock"
            connection.exec_driver_sql(f"SELECT {lock}({_WRITERS_LOCK})")
        else:
            connection.exec_driver_sql(
                "SET TRANSACTION ISOLATION LEVEL REPEATABLE READ READ ONLY;"
                f"SET LOCAL statement_timeout = {limit_ms}"
            )

    def rest(raw: Any, _record: Any) -> None:
        # Before its next use a connection is asked for a sign of life, and that is short.
        if raw is not None:
            raw.answer_s = CONNECT_S

    event.listen(engine, "do_connect", connect)
    event.listen(engine, "begin", begin)
    event.listen(engine, "checkin", rest)
    return engine
