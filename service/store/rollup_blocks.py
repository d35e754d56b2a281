"""Blocks of rollups: the minutes of four hours of a channel, and the seconds of an hour.

Hours are rows of their own. Ten minutes are made of the minutes. What an earlier version left as
rows of seconds, minutes and ten minutes is read next to the blocks, and moved into them little by
little: a bucket is a row or in a block, never both.
"""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
import structlog
from cachetools import LRUCache
from numpy.typing import NDArray
from pcodec import ChunkConfig, standalone
from sqlalchemy import Connection, Select, delete, select, text, tuple_

from service.clock import HOUR_US, rfc3339
from service.store.blocks import CODEC, Block, BlockDamagedError, is_damaged
from service.store.errors import StoreError
from service.store.part import rows_of
from service.store.tables import (
    ChannelRow,
    PackedHourRow,
    RollupBlockRow,
    RollupRow,
    SampleRow,
)

#: How much of a channel one block holds, by the length of its buckets in seconds. Four hours of
#: minutes take some 700 bytes; SQLite puts what is above 1000 on a page of its own.
SPANS_US = {1: HOUR_US, 60: 4 * HOUR_US}
#: A block is written again as its hours pass: more of pcodec's levels costs more than it saves.
_CONFIG = ChunkConfig(compression_level=4)
_SECOND_US = 1_000_000
#: Both databases know it.
_RESERVE = text(
    "INSERT INTO rollup_blocks (channel_id, resolution_s, begin_us, codec, crc, data) "
    "VALUES (:channel_id, :resolution_s, :begin_us, :codec, :crc, :data) ON CONFLICT DO NOTHING"
)
_REPLACE = text(
    "UPDATE rollup_blocks SET codec = :codec, crc = :crc, data = :data WHERE "
    "channel_id = :channel_id AND resolution_s = :resolution_s AND begin_us = :begin_us"
)
_MARK = text(
    "INSERT INTO stale_rollups (channel_id, hour_us) VALUES (:channel_id, :hour_us) "
    "ON CONFLICT DO NOTHING"
)

#: Blocks that the log has named.
_logged: LRUCache["Key", bool] = LRUCache(1000)

_log = structlog.get_logger(__name__)

Key = tuple[int, int, int]
"""Channel, seconds of a bucket, begin of the block."""


class Buckets(NamedTuple):
    """Buckets of one channel, ascending by time; see `service.store.buckets.Bucket`.

    Where no sample is good, the three values are not a number.
    """

    times_us: NDArray[np.int64]
    means: NDArray[np.float64]
    lows: NDArray[np.float64]
    highs: NDArray[np.float64]
    good: NDArray[np.int64]
    qualities: NDArray[np.uint16]

    def taken(self, which: NDArray[np.bool_] | NDArray[np.int64] | slice) -> "Buckets":
        """Give some of them."""
        times_us, means, lows, highs, good, qualities = self
        return Buckets(
            times_us[which], means[which], lows[which], highs[which], good[which], qualities[which]
        )


NOTHING = Buckets(
    np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0),
    np.empty(0, np.int64), np.empty(0, np.uint16),
)  # fmt: skip


class _Columns(msgspec.Struct, frozen=True, array_like=True):
    """What a block consists of; each column by pcodec.

    Times are numbers of buckets from the begin of the block. ``lows`` and ``highs`` are empty
    where they are the means, as of one sample a second.
    """

    times: bytes
    means: bytes
    lows: bytes
    highs: bytes
    good: bytes
    qualities: bytes


def pack(buckets: Buckets, resolution_s: int, begin_us: int) -> Block:
    """Compress buckets of one channel, to the last bit; no bytes stand for no buckets."""
    times_us, means, lows, highs, good, qualities = buckets
    if not times_us.size:
        return Block(CODEC, zlib.crc32(b""), b"")

    def values(column: NDArray[np.float64]) -> bytes:
        same = column is not means and column.tobytes() == means.tobytes()
        return b"" if same else standalone.simple_compress(np.ascontiguousarray(column), _CONFIG)

    numbers = (times_us - begin_us) // (resolution_s * _SECOND_US)
    data = msgspec.msgpack.encode(
        _Columns(
            standalone.simple_compress(numbers.astype(np.uint16), _CONFIG),
            values(means),
            values(lows),
            values(highs),
            standalone.simple_compress(good.astype(np.uint32), _CONFIG),
            standalone.simple_compress(np.ascontiguousarray(qualities), _CONFIG),
        )
    )
    return Block(CODEC, zlib.crc32(data), data)


def unpack(block: Block, resolution_s: int, begin_us: int) -> Buckets:
    """Give the buckets of a block.

    Raises `BlockDamagedError` if the block is damaged; `StoreError` if a later version made it.
    """
    if block.codec != CODEC:
        raise StoreError(
            f"a block of rollups has codec {block.codec}: expected {CODEC}; a later version made it"
        )
    if is_damaged(block):
        raise BlockDamagedError("its checksum differs")
    if not block.data:
        return NOTHING
    columns = msgspec.msgpack.decode(block.data, type=_Columns)
    numbers = np.asarray(standalone.simple_decompress(columns.times), np.int64)
    means = np.asarray(standalone.simple_decompress(columns.means), np.float64)

    def values(column: bytes) -> NDArray[np.float64]:
        return np.asarray(standalone.simple_decompress(column), np.float64) if column else means

    return Buckets(
        begin_us + numbers * (resolution_s * _SECOND_US),
        means,
        values(columns.lows),
        values(columns.highs),
        np.asarray(standalone.simple_decompress(columns.good), np.int64),
        np.asarray(standalone.simple_decompress(columns.qualities), np.uint16),
    )


def read(
    connection: Connection, channel_id: int, resolution_s: int, begin_us: int, end_us: int
) -> Iterator[tuple[int, Buckets | None]]:
    """Give the begins of the blocks that reach into a span, and their buckets within it.

    None stands for a damaged block.
    """
    row = RollupBlockRow
    query = select(row.begin_us, row.codec, row.crc, row.data).where(
        row.channel_id == channel_id,
        row.resolution_s == resolution_s,
        row.begin_us > begin_us - SPANS_US[resolution_s],
        row.begin_us < end_us,
    )
    for block_us, codec, crc, data in connection.execute(query.order_by(row.begin_us)).all():
        found = _unpacked(channel_id, resolution_s, block_us, Block(codec, crc, data))
        if found is not None:
            first, last = np.searchsorted(found.times_us, (begin_us, end_us))
            found = found.taken(slice(first, last))
        yield block_us, found


def put(
    connection: Connection,
    channel_ids: Sequence[int],
    resolution_s: int,
    hour_us: int,
    new: Mapping[int, Buckets],
    *,
    replaces_hour: bool,
) -> None:
    """Add buckets of channels to their blocks; one of the same time gives way.

    - ``channel_ids``: those that are looked at; ``new`` has some of them.
    - ``hour_us``: begin of an hour in the block that all new ones belong to.
    - ``replaces_hour``: all buckets of that hour give way.
    """
    begin_us = hour_us - hour_us % SPANS_US[resolution_s]
    row = RollupBlockRow
    empty = pack(NOTHING, resolution_s, begin_us)._asdict()
    keys = [
        {"channel_id": channel_id, "resolution_s": resolution_s, "begin_us": begin_us}
        for channel_id in sorted(new)
    ]
    if keys:
        # Who adds to a block that is not there yet finds the one that another program adds, and
        # waits. In one order: two cannot wait for each other.
        connection.execute(_RESERVE, [{**key, **empty} for key in keys])
    query = select(row.channel_id, row.codec, row.crc, row.data).where(
        row.resolution_s == resolution_s, row.begin_us == begin_us
    )
    query = query.order_by(row.channel_id).with_for_update()
    changes = []
    for channel_id, *packed in rows_of(connection, row.channel_id, query, channel_ids):
        stored = _unpacked(channel_id, resolution_s, begin_us, Block(*packed))
        if stored is None:
            _mark_stale(connection, channel_id, begin_us, begin_us + SPANS_US[resolution_s])
            stored = NOTHING
        added = new.get(channel_id, NOTHING)
        gone = np.isin(stored.times_us, added.times_us)
        if replaces_hour:
            gone |= stored.times_us // HOUR_US == hour_us // HOUR_US
        block = pack(_joined(stored.taken(~gone), added), resolution_s, begin_us)
        changes.append(
            {
                "channel_id": channel_id, "resolution_s": resolution_s, "begin_us": begin_us,
                **block._asdict(),
            }
        )  # fmt: skip
    if changes:
        connection.execute(_REPLACE, changes)


def remove_before(connection: Connection, resolution_s: int, before_us: int) -> int:
    """Remove the blocks that end by a time; returns how many."""
    return connection.execute(
        delete(RollupBlockRow).where(
            RollupBlockRow.resolution_s == resolution_s,
            RollupBlockRow.begin_us <= before_us - SPANS_US[resolution_s],
        )
    ).rowcount


def oldest_row(resolution_s: int) -> Select[str, int, int | None]:
    """Select asset, number and the oldest time of the rows of each channel that can be a block."""
    row = RollupRow
    oldest = (
        select(row.time_us)
        .where(row.channel_id == ChannelRow.id, row.resolution_s == resolution_s)
        .order_by(row.time_us)
        .limit(1)
        .scalar_subquery()
    )
    return select(ChannelRow.asset, ChannelRow.id, oldest.label("time_us"))


def move_rows(connection: Connection, channel_id: int, resolution_s: int, time_us: int) -> int:
    """Move the rows of a channel around a time into their block; returns how many are gone.

    No other program may write meanwhile. Ten minutes go where their minutes are in the block.
    """
    begin_us = time_us - time_us % SPANS_US[resolution_s]
    row = RollupRow
    here = (
        row.channel_id == channel_id,
        row.time_us >= begin_us,
        row.time_us < begin_us + SPANS_US[resolution_s],
    )
    query = select(row.time_us, row.mean, row.low, row.high, row.good, row.quality)
    query = query.where(*here, row.resolution_s == resolution_s).order_by(row.time_us)
    rows = connection.execute(query).all()
    if not rows:
        return 0
    columns = zip(*rows, strict=True)
    kinds = (np.int64, np.float64, np.float64, np.float64, np.int64, np.uint16)
    moved = Buckets(*(np.array(column, kind) for column, kind in zip(columns, kinds, strict=True)))
    put(connection, [channel_id], resolution_s, begin_us, {channel_id: moved}, replaces_hour=False)
    gone = connection.execute(delete(row).where(*here, row.resolution_s == resolution_s)).rowcount
    if resolution_s == 60:
        hours_us = np.unique(moved.times_us // HOUR_US) * HOUR_US
        ten_minutes = (row.resolution_s == 600, row.time_us - row.time_us % HOUR_US)
        gone += connection.execute(
            delete(row).where(*here, ten_minutes[0], ten_minutes[1].in_(hours_us.tolist()))
        ).rowcount
    return gone


def damaged_assets(connection: Connection, after: Key, limit: int) -> tuple[set[str], Key | None]:
    """Look through the next blocks: the assets of damaged ones, and the last block looked at."""
    row = RollupBlockRow
    key = (row.channel_id, row.resolution_s, row.begin_us)
    query = (
        select(*key, row.codec, row.crc, row.data, ChannelRow.asset)
        .join(ChannelRow, ChannelRow.id == row.channel_id, isouter=True)
        .where(tuple_(*key) > tuple_(*after))
        .order_by(*key)
        .limit(limit)
    )
    rows = connection.execute(query).all()
    assets = {str(row[6]) for row in rows if is_damaged(Block(*row[3:6]))}
    return assets, (rows[-1][0], rows[-1][1], rows[-1][2]) if rows else None


def _unpacked(channel_id: int, resolution_s: int, begin_us: int, block: Block) -> Buckets | None:
    try:
        return unpack(block, resolution_s, begin_us)
    except BlockDamagedError as error:
        key = channel_id, resolution_s, begin_us
        if key not in _logged:
            _logged[key] = True
            _log.error(
                "rollup_block_damaged",
                channel_id=channel_id,
                resolution_s=resolution_s,
                begin=rfc3339(begin_us),
                reason=str(error),
            )
        return None


def _mark_stale(connection: Connection, channel_id: int, begin_us: int, end_us: int) -> None:
    """Have the hours of a damaged block computed again of which there are samples."""
    packed = select(PackedHourRow.hour_us).where(
        PackedHourRow.channel_id == channel_id,
        PackedHourRow.hour_us >= begin_us,
        PackedHourRow.hour_us < end_us,
    )
    time_us = SampleRow.time_us.expression
    in_table = select(time_us - time_us % HOUR_US).where(
        SampleRow.channel_id == channel_id, time_us >= begin_us, time_us < end_us
    )
    hours_us = {*connection.scalars(packed), *connection.scalars(in_table.distinct())}
    if hours_us:
        marks = [{"channel_id": channel_id, "hour_us": hour_us} for hour_us in sorted(hours_us)]
        connection.execute(_MARK, marks)


def _joined(a: Buckets, b: Buckets) -> Buckets:
    order = np.argsort(np.concatenate((a.times_us, b.times_us)))
    return Buckets(
        np.concatenate((a.times_us, b.times_us))[order],
        np.concatenate((a.means, b.means))[order],
        np.concatenate((a.lows, b.lows))[order],
        np.concatenate((a.highs, b.highs))[order],
        np.concatenate((a.good, b.good))[order],
        np.concatenate((a.qualities, b.qualities))[order],
    )
