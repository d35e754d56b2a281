"""Many rows at once from and to PostgreSQL: column by column, without a step for each row."""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
import psycopg
from numpy.typing import NDArray
from sqlalchemy import Connection
from sqlalchemy.exc import IntegrityError, OperationalError

from service.store.blocks import UNKNOWN_US, ChannelSamples
from service.store.database import RollupColumns

#: One row for each channel: a row for each sample would be a step of the program for each.
_READ = """
SELECT channel_id, string_agg(
    int8send(time_us) || float8send(COALESCE(value, 'NaN')) || int2send(quality)
    || int8send(COALESCE(received_us, {unknown_us})),
    ''::bytea ORDER BY time_us
) FROM (
    SELECT channel_id, time_us, value, quality, received_us
    FROM samples WHERE channel_id IN ({ids}) AND time_us >= {begin_us} AND time_us < {end_us}
    ORDER BY channel_id, time_us LIMIT {count_max}
) AS first_samples GROUP BY channel_id ORDER BY channel_id
"""
_SAMPLE = np.dtype(
    [("time_us", ">i8"), ("value", ">f8"), ("quality", ">i2"), ("received_us", ">i8")]
)
_COPY_ROLLUPS = (
    "COPY rollups (channel_id, resolution_s, time_us, good, quality, mean, low, high) "
    "FROM STDIN (FORMAT BINARY)"
)
COPY_HEADER = b"PGCOPY\n\xff\r\n\x00" + bytes(8)
COPY_TRAILER = b"\xff\xff"
#: The binary format of COPY: a header, rows, a trailer. Each row begins with the number of its
#: fields, each field with its length in bytes; what is missing has the length -1.
ROW = np.dtype(
    [
        ("fields", ">i2"),
        ("channel_id_length", ">i4"),
        ("channel_id", ">i4"),
        ("time_us_length", ">i4"),
        ("time_us", ">i8"),
        ("value_length", ">i4"),
        ("value", ">f8"),
        ("quality_length", ">i4"),
        ("quality", ">i2"),
        ("received_us_length", ">i4"),
        ("received_us", ">i8"),
    ]
)
_ROLLUP_FIELDS = (
    ("channel_ids", ">i4"), ("resolutions_s", ">i2"), ("times_us", ">i8"), ("good", ">i4"),
    ("qualities", ">i2"), ("means", ">f8"), ("lows", ">f8"), ("highs", ">f8"),
)  # fmt: skip
#: Of these there is no value in a bucket without good samples.
_VALUES = ("means", "lows", "highs")


def read_samples(
    connection: Connection, channel_ids: Sequence[int], begin_us: int, end_us: int, count_max: int
) -> tuple[NDArray[np.int64], ChannelSamples]:
    """See `service.store.database.Dialect`."""
    query = _READ.format(
        unknown_us=f"'{UNKNOWN_US}'::bigint",
        ids=", ".join(map(str, channel_ids)),
        begin_us=begin_us,
        end_us=end_us,
        count_max=count_max,
    )
    cursor: Any = connection.connection.cursor()
    try:
        rows = cursor.execute(query, binary=True).fetchall()
    except (psycopg.OperationalError, psycopg.InternalError) as error:
        raise OperationalError(query, None, error) from error  # as it comes from other statements
    finally:
        cursor.close()
    parts = [np.frombuffer(data, _SAMPLE) for _, data in rows]
    samples = np.concatenate(parts) if parts else np.empty(0, _SAMPLE)
    ids = np.repeat(np.array([row[0] for row in rows], np.int64), [part.size for part in parts])
    return ids, ChannelSamples(
        samples["time_us"].astype(np.int64),
        samples["value"].astype(np.float64),
        samples["quality"].astype(np.uint16),
        samples["received_us"].astype(np.int64),
    )


def insert_rollups(connection: Connection, columns: RollupColumns) -> None:
    """See `service.store.database.Dialect`."""
    is_empty = columns.good == 0
    data = b"".join(
        (
            COPY_HEADER,
            _rollups(columns, ~is_empty, ()),
            _rollups(columns, is_empty, _VALUES),
            COPY_TRAILER,
        )
    )
    cursor: Any = connection.connection.cursor()
    try:
        with cursor.copy(_COPY_ROLLUPS) as copy:
            copy.write(data)
    except (psycopg.OperationalError, psycopg.InternalError) as error:
        raise OperationalError(_COPY_ROLLUPS, None, error) from error
    except psycopg.IntegrityError as error:
        raise IntegrityError(_COPY_ROLLUPS, None, error) from error
    finally:
        cursor.close()


def _rollups(columns: RollupColumns, chosen: NDArray[np.bool_], missing: Collection[str]) -> bytes:
    """Some rows in the binary format of COPY."""
    fields: list[tuple[str, str]] = [("fields", ">i2")]
    for name, kind in _ROLLUP_FIELDS:
        fields.append((f"{name}_length", ">i4"))
        if name not in missing:
            fields.append((name, kind))
    rows = np.empty(np.count_nonzero(chosen), np.dtype(fields))
    rows["fields"] = len(_ROLLUP_FIELDS)
    for name, kind in _ROLLUP_FIELDS:
        rows[f"{name}_length"] = -1 if name in missing else np.dtype(kind).itemsize
        if name not in missing:
            rows[name] = getattr(columns, name)[chosen]
    return rows.tobytes()
