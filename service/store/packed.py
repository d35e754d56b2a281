"""Hours whose samples are in blocks: what is in them, and how they are removed.

An hour of a channel is either in the table of samples or in a block, never in both. A block that
is damaged has no samples, and costs no other its own.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import structlog
from cachetools import LRUCache
from sqlalchemy import Connection, Select, delete, func, insert, select, tuple_

from service.clock import HOUR_US, rfc3339
from service.store.blocks import UNKNOWN_US, Block, BlockDamagedError, ChannelSamples, pack, unpack
from service.store.part import rows_of
from service.store.tables import PackedHourRow, SampleBlockRow

#: Hours that are looked up at a time.
_HOURS = 64
NOTHING = ChannelSamples(
    np.empty(0, np.int64), np.empty(0), np.empty(0, np.uint16), np.empty(0, np.int64)
)

#: Blocks that the log has named.
_logged: LRUCache[int, bool] = LRUCache(1000)

_log = structlog.get_logger(__name__)


Row = tuple[int, float | None, int, int | None]
"""Time, value, quality and received time of a sample, as the table of samples has them."""


class PackedHour(NamedTuple):
    """Where an hour of a channel is, and its times of the first and the last sample."""

    channel_id: int
    hour_us: int
    block_id: int
    position: int
    first_us: int
    last_us: int
    sample_count: int


def read(
    connection: Connection, channel_id: int, begin_us: int, end_us: int
) -> Iterator[ChannelSamples]:
    """Give the packed samples of a span, hour by hour as they are asked for."""
    for hour in _hours(connection, channel_id, begin_us, end_us):
        yield samples_of(connection, hour).within(begin_us, end_us)


def span(
    connection: Connection, channel_id: int, begin_us: int, end_us: int
) -> tuple[int, int, int] | None:
    """Give the times of the first and the last packed sample of a span, and the count."""
    of_channel = PackedHourRow.channel_id == channel_id
    first_us, last_us, total = connection.execute(
        select(
            func.min(PackedHourRow.first_us),
            func.max(PackedHourRow.last_us),
            func.sum(PackedHourRow.sample_count),
        ).where(
            of_channel,
            PackedHourRow.hour_us > begin_us - HOUR_US,
            PackedHourRow.first_us >= begin_us,
            PackedHourRow.last_us < end_us,
        )
    ).one()
    found = [] if first_us is None else [(first_us, last_us, int(total))]
    # At most two hours are cut by an end of the span.
    for hour_us in {begin_us - begin_us % HOUR_US, end_us - end_us % HOUR_US}:
        query = _select().where(of_channel, PackedHourRow.hour_us == hour_us)
        for row in connection.execute(query).all():
            hour = PackedHour(*row)
            if begin_us <= hour.first_us and hour.last_us < end_us:
                continue
            times_us = samples_of(connection, hour).within(begin_us, end_us).times_us
            if times_us.size:
                found.append((int(times_us[0]), int(times_us[-1]), times_us.size))
    if not found:
        return None
    firsts, lasts, counts = zip(*found, strict=True)
    return min(firsts), max(lasts), sum(counts)


def first_time_us(connection: Connection, channel_id: int, start_us: int) -> int | None:
    """Time of the first packed sample of a channel at or after a time."""
    for hour in _hours(connection, channel_id, start_us, 2**63 - 1):
        if hour.first_us >= start_us:
            return hour.first_us
        times_us = samples_of(connection, hour).times_us
        later = times_us[np.searchsorted(times_us, start_us) :]
        if later.size:
            return int(later[0])
    return None


def last_time_us(connection: Connection, channel_id: int, end_us: int) -> int | None:
    """Time of the last packed sample of a channel before a time."""
    row = newest(connection, channel_id, -1, end_us)
    return None if row is None else row[0]


def newest(
    connection: Connection, channel_id: int, after_us: int, before_us: int = 2**63 - 1
) -> Row | None:
    """Give the newest packed sample of a channel between two times, both not included."""
    while True:
        query = _select().where(
            PackedHourRow.channel_id == channel_id,
            PackedHourRow.hour_us > after_us - HOUR_US,
            PackedHourRow.hour_us < before_us,
            PackedHourRow.last_us > after_us,
        )
        row = connection.execute(query.order_by(PackedHourRow.hour_us.desc()).limit(1)).first()
        if row is None:
            return None
        hour = PackedHour(*row)
        samples = samples_of(connection, hour)
        inside = samples.within(after_us + 1, before_us)
        if inside.times_us.size:
            return rows(inside)[-1]
        before_us = hour.hour_us  # its block is damaged, or it begins later: the one before it


def count(connection: Connection, channel_id: int) -> int:
    """Count the packed samples of a channel."""
    total = select(func.sum(PackedHourRow.sample_count)).where(
        PackedHourRow.channel_id == channel_id
    )
    return int(connection.scalar(total) or 0)


def rows(samples: ChannelSamples) -> list[Row]:
    """Give samples as rows of the table of samples."""
    columns = (column.tolist() for column in samples)
    return [
        (
            time_us,
            None if value != value else value,
            quality,
            None if received_us == UNKNOWN_US else received_us,
        )
        for time_us, value, quality, received_us in zip(*columns, strict=True)
    ]


def samples_of(connection: Connection, hour: PackedHour) -> ChannelSamples:
    """Give the samples of a packed hour; none if its block is lost."""
    query = select(SampleBlockRow.codec, SampleBlockRow.crc, SampleBlockRow.data)
    block = connection.execute(query.where(SampleBlockRow.id == hour.block_id)).one_or_none()
    try:
        if block is None:
            raise BlockDamagedError("it is missing")
        samples = unpack(Block(*block), hour.position)
        times_us = samples.times_us
        ends = (times_us.size, int(times_us[0]), int(times_us[-1])) if times_us.size else ()
        if ends != (hour.sample_count, hour.first_us, hour.last_us):
            raise BlockDamagedError("it is that of another hour")
    except BlockDamagedError as error:
        if hour.block_id not in _logged:
            _logged[hour.block_id] = True
            _log.error(
                "block_damaged",
                block=hour.block_id,
                channel_id=hour.channel_id,
                hour=rfc3339(hour.hour_us),
                reason=str(error),
            )
        return NOTHING
    return samples


def hours_of(connection: Connection, keys: Collection[tuple[int, int]]) -> list[PackedHour]:
    """Find which of these channels and hours are packed."""
    key = tuple_(PackedHourRow.channel_id, PackedHourRow.hour_us)
    return [PackedHour(*row) for row in rows_of(connection, key, _select(), keys)]


def hours_within(
    connection: Connection, channel_ids: Collection[int], hour_us: int
) -> list[PackedHour]:
    """Find which of these channels have this hour packed."""
    this = PackedHourRow.hour_us == hour_us
    if connection.scalar(select(PackedHourRow.hour_us).where(this).limit(1)) is None:
        return []
    key = PackedHourRow.channel_id
    query = _select().where(this)
    return [PackedHour(*row) for row in rows_of(connection, key, query, channel_ids)]


def add(
    connection: Connection, hour_us: int, groups: Iterable[Sequence[tuple[int, ChannelSamples]]]
) -> None:
    """Store an hour of channels, each group in one block; those of a group have the same times."""
    places = []
    for group in groups:
        block = pack([samples for _, samples in group])
        block_id = connection.execute(
            insert(SampleBlockRow).values(**block._asdict()).returning(SampleBlockRow.id)
        ).scalar_one()
        for position, (channel_id, samples) in enumerate(group):
            times_us = samples.times_us
            ends = int(times_us[0]), int(times_us[-1])
            place = PackedHour(channel_id, hour_us, block_id, position, *ends, times_us.size)
            places.append(place._asdict())
    if places:
        connection.execute(insert(PackedHourRow), places)


def remove(connection: Connection, channel_id: int, hour_us: int) -> int:
    """Remove a packed hour, and its block when nothing else is in it; returns its samples."""
    this = (PackedHourRow.channel_id == channel_id, PackedHourRow.hour_us == hour_us)
    found = connection.execute(
        delete(PackedHourRow)
        .where(*this)
        .returning(PackedHourRow.block_id, PackedHourRow.sample_count)
    ).one_or_none()
    if found is None:
        return 0
    # Two that each remove one of the last two hours of a block: the second sees that both are gone.
    block = select(SampleBlockRow.id).where(SampleBlockRow.id == found.block_id)
    connection.execute(block.with_for_update())
    others = select(PackedHourRow.block_id).where(PackedHourRow.block_id == found.block_id)
    if connection.scalar(others.limit(1)) is None:
        connection.execute(delete(SampleBlockRow).where(SampleBlockRow.id == found.block_id))
    return int(found.sample_count)


def _select() -> Select[int, int, int, int, int, int, int]:
    return select(
        PackedHourRow.channel_id,
        PackedHourRow.hour_us,
        PackedHourRow.block_id,
        PackedHourRow.position,
        PackedHourRow.first_us,
        PackedHourRow.last_us,
        PackedHourRow.sample_count,
    )


def _hours(
    connection: Connection, channel_id: int, begin_us: int, end_us: int
) -> Iterator[PackedHour]:
    """Walk along the packed hours of a channel that reach into a span."""
    after_us = begin_us - HOUR_US
    while True:
        query = (
            _select()
            .where(
                PackedHourRow.channel_id == channel_id,
                PackedHourRow.hour_us > after_us,
                PackedHourRow.hour_us < end_us,
            )
            .order_by(PackedHourRow.hour_us)
            .limit(_HOURS)
        )
        found = [PackedHour(*row) for row in connection.execute(query).all()]
        yield from found
        if len(found) < _HOURS:
            return
        after_us = found[-1].hour_us
