"""Samples of times that no sample can have, as earlier versions took them: found and removed."""

from collections.abc import Callable, Collection
from typing import NamedTuple

from sqlalchemy import ColumnElement, Connection, delete, func, select
from sqlalchemy.orm import InstrumentedAttribute

from adapters.times import EARLIEST_US, latest_us
from service.store import packed
from service.store.audit import add_line
from service.store.part import StorePart
from service.store.records import AuditEntry
from service.store.rollup_blocks import SPANS_US
from service.store.tables import (
    ChannelRow,
    PackedHourRow,
    RollupBlockRow,
    RollupRow,
    SampleRow,
    StaleRollupRow,
)

#: Samples of one transaction: other writers have their turn in between.
_PORTION = 20_000
_BLOCK_US = max(SPANS_US.values())
_Span = tuple[int, int]


class ImpossibleSamples(NamedTuple):
    """How many samples of a channel have impossible times, and the first and last of these."""

    asset: str
    channel: str
    samples: int
    first_us: int
    last_us: int


class ImpossibleTimes(StorePart):
    """Samples from before 1990 or, in whole blocks, from the day after tomorrow."""

    def find(self, now_us: int, assets: Collection[str] | None = None) -> list[ImpossibleSamples]:
        """Find the channels, of some assets or of all, that have such samples.

        ``now_us``: process time, UTC microseconds.
        """
        found = []
        with self._database.reading() as connection:
            query = select(ChannelRow.asset, ChannelRow.name, ChannelRow.id)
            if assets is not None:
                query = query.where(ChannelRow.asset.in_(assets))
            channels = connection.execute(query.order_by(ChannelRow.asset, ChannelRow.name)).all()
            for asset, name, channel_id in channels:
                parts = [_count(connection, channel_id, span) for span in _spans(now_us)]
                whole = [part for part in parts if part is not None]
                if whole:
                    counts, firsts, lasts = zip(*whole, strict=True)
                    found.append(
                        ImpossibleSamples(asset, name, sum(counts), min(firsts), max(lasts))
                    )
        return found

    def remove(self, now_us: int, line: Callable[[int], AuditEntry]) -> int:
        """Remove them with what was computed of them; returns how many samples there were.

        ``line``: makes a line of the audit trail of their number, in the transaction that removes
        them: what is removed before an interruption has its line.
        """
        with self._database.reading() as connection:
            channel_ids = list(connection.scalars(select(ChannelRow.id)))
        return sum(
            self._remove(channel_id, span, line)
            for channel_id in channel_ids
            for span in _spans(now_us)
        )

    def _remove(self, channel_id: int, span: _Span, line: Callable[[int], AuditEntry]) -> int:
        inside = _inside(SampleRow.channel_id, SampleRow.time_us, channel_id, span)
        next_times = select(SampleRow.time_us).where(*inside).order_by(SampleRow.time_us)
        removed = 0
        while True:
            with self._database.reading() as connection:
                left = _is_there(connection, channel_id, span)
                times_us = list(connection.scalars(next_times.limit(_PORTION)))
            if not left:
                return removed
            with self._database.writing() as connection:
                if times_us:
                    until = SampleRow.time_us <= times_us[-1]
                    count = connection.execute(delete(SampleRow).where(*inside, until)).rowcount
                    add_line(connection, line(count))
                    removed += count
                    continue
                hours = _inside(PackedHourRow.channel_id, PackedHourRow.hour_us, channel_id, span)
                hours_us = connection.scalars(select(PackedHourRow.hour_us).where(*hours)).all()
                count = sum(packed.remove(connection, channel_id, one) for one in hours_us)
                if count:
                    add_line(connection, line(count))
                    removed += count
                for row, time_us in (
                    (RollupRow, RollupRow.time_us),
                    (RollupBlockRow, RollupBlockRow.begin_us),
                    (StaleRollupRow, StaleRollupRow.hour_us),
                ):
                    connection.execute(
                        delete(row).where(*_inside(row.channel_id, time_us, channel_id, span))
                    )


def _spans(now_us: int) -> tuple[_Span, _Span]:
    """Where no sample can be; both ends are those of blocks, so that no block is cut."""
    end_us = (latest_us(now_us) // _BLOCK_US + 1) * _BLOCK_US
    return (-1, EARLIEST_US), (end_us, 2**63 - 1)


def _inside(
    number: InstrumentedAttribute[int],
    time_us: InstrumentedAttribute[int],
    channel_id: int,
    span: _Span,
) -> tuple[ColumnElement[bool], ...]:
    return number == channel_id, time_us >= span[0], time_us < span[1]


def _count(connection: Connection, channel_id: int, span: _Span) -> tuple[int, int, int] | None:
    """Count the samples of a channel in a span, with the times of the first and the last."""
    sample, hour = SampleRow, PackedHourRow
    queries = (
        select(func.count(), func.min(sample.time_us), func.max(sample.time_us)).where(
            *_inside(sample.channel_id, sample.time_us, channel_id, span)
        ),
        select(func.sum(hour.sample_count), func.min(hour.first_us), func.max(hour.last_us)).where(
            *_inside(hour.channel_id, hour.hour_us, channel_id, span)
        ),
    )
    rows = [tuple(connection.execute(query).one()) for query in queries]
    found = [(int(count), first, last) for count, first, last in rows if count]
    if not found:
        return None
    counts, firsts, lasts = zip(*found, strict=True)
    return sum(counts), min(firsts), max(lasts)


def _is_there(connection: Connection, channel_id: int, span: _Span) -> bool:
    """Whether anything of a channel is in a span."""
    return any(
        connection.scalar(
            select(time_us).where(*_inside(number, time_us, channel_id, span)).limit(1)
        )
        is not None
        for number, time_us in (
            (SampleRow.channel_id, SampleRow.time_us),
            (PackedHourRow.channel_id, PackedHourRow.hour_us),
            (RollupRow.channel_id, RollupRow.time_us),
            (RollupBlockRow.channel_id, RollupBlockRow.begin_us),
            (StaleRollupRow.channel_id, StaleRollupRow.hour_us),
        )
    )
