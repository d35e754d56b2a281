"""Statistics of the samples per bucket of time: rollups for people, minutes for the twin."""

import heapq
from collections.abc import Sequence
from operator import attrgetter

import numpy as np
from sqlalchemy import ColumnElement, Connection, case, func, select

from adapters.samples import Quality
from service.store.records import MinuteTable, Rollup
from service.store.samples import channel_ids, first_time_us
from service.store.section import Section
from service.store.tables import SampleRow

MINUTE_US = 60_000_000

_good_value = case((SampleRow.quality >= Quality.GOOD, SampleRow.value))
_mean = func.avg(_good_value)
_good_count = func.count(_good_value)
_in_time_order = attrgetter("time_us", "channel")


class History(Section):
    """Computed from the raw samples when asked for."""

    def read_rollup(
        self,
        asset: str,
        channels: Sequence[str] | None,
        start_us: int,
        end_us: int,
        bucket_us: int,
        limit: int,
        after: tuple[int, str] | None = None,
    ) -> list[Rollup]:
        """Statistics per bucket, ascending by time, then by channel name.

        Buckets are whole: a bucket belongs to the answer when its start lies in the span, and
        then all its samples count. Buckets without any sample are absent.

        Parameters
        ----------
        asset : str
            Asset to read.
        channels : sequence of str or None
            Which channels; None for all.
        start_us, end_us : int
            UTC microseconds; the start is included, the end is not.
        bucket_us : int
            Length of a bucket; buckets are counted from the epoch.
        limit : int
            Rollups at most.
        after : tuple of int and str, optional
            Time and channel of the last rollup of the page before: go on behind it.
        """
        if bucket_us <= 0:
            raise ValueError(f"bucket_us = {bucket_us}: expected a positive number")
        first_us = -(-max(start_us, 0) // bucket_us) * bucket_us
        end_us = -(-end_us // bucket_us) * bucket_us
        with self._database.reading() as connection:
            ids = channel_ids(connection, asset, channels)
            per_channel = []
            for name, channel_id in ids.items():
                begin_us = first_us
                if after is not None:
                    begin_us = max(first_us, after[0] + bucket_us * (name <= after[1]))
                rows = _buckets(connection, channel_id, begin_us, end_us, bucket_us, limit)
                per_channel.append([Rollup(name, *row) for row in rows])
        merged = heapq.merge(*per_channel, key=_in_time_order)
        return [rollup for rollup, _ in zip(merged, range(limit), strict=False)]

    def minute_averages(
        self,
        asset: str,
        channels: Sequence[str],
        start_us: int,
        end_us: int,
        offset_us: int = 0,
    ) -> MinuteTable:
        """Averages per minute of the good samples, on one time axis for all channels.

        Parameters
        ----------
        asset : str
            Asset to read.
        channels : sequence of str
            Which channels; one that was never stored is all NaN.
        start_us, end_us : int
            UTC microseconds; samples in the half-open span count.
        offset_us : int
            Minutes begin so much after the full minute; minus half a minute centres the averages
            on the full minutes, as an instantaneous value there.
        """
        per_channel: dict[str, list[tuple[int, float | None, int, int]]] = {}
        with self._database.reading() as connection:
            ids = channel_ids(connection, asset, channels)
            for name, channel_id in ids.items():
                minute = _bucket(MINUTE_US, offset_us)
                query = select(minute, _mean, _good_count, func.count()).where(
                    SampleRow.channel_id == channel_id,
                    SampleRow.time_us >= start_us,
                    SampleRow.time_us < end_us,
                )
                per_channel[name] = [
                    (time_us, mean, good, count)
                    for time_us, mean, good, count in connection.execute(query.group_by(minute))
                ]
        minute_us = np.array(
            sorted({row[0] for rows in per_channel.values() for row in rows}), dtype=np.int64
        )
        table = MinuteTable(minute_us, mean={}, good_count={}, bad_count={})
        for name in channels:
            mean = np.full(minute_us.size, np.nan)
            good = np.zeros(minute_us.size, dtype=np.int64)
            bad = np.zeros(minute_us.size, dtype=np.int64)
            if rows := per_channel.get(name):
                times, means, goods, counts = zip(*rows, strict=True)
                at = np.searchsorted(minute_us, np.array(times, dtype=np.int64))
                mean[at] = [np.nan if value is None else value for value in means]
                good[at] = goods
                bad[at] = np.array(counts, dtype=np.int64) - np.array(goods, dtype=np.int64)
            table.mean[name] = mean
            table.good_count[name] = good
            table.bad_count[name] = bad
        return table


def _bucket(bucket_us: int, offset_us: int = 0) -> ColumnElement[int]:
    return SampleRow.time_us - (SampleRow.time_us - offset_us) % bucket_us


def _buckets(
    connection: Connection,
    channel_id: int,
    begin_us: int,
    end_us: int,
    bucket_us: int,
    limit: int,
) -> list[tuple[int, float | None, float | None, float | None, int, int]]:
    """Read the first ``limit`` buckets of a channel; gaps are jumped over, not walked through."""
    start = _bucket(bucket_us)
    found: list[tuple[int, float | None, float | None, float | None, int, int]] = []
    while len(found) < limit:
        first_us = first_time_us(connection, channel_id, begin_us)
        if first_us is None or first_us >= end_us:
            break
        begin_us = first_us - first_us % bucket_us
        chunk_end_us = min(begin_us + (limit - len(found)) * bucket_us, end_us)
        query = (
            select(
                start,
                _mean,
                func.min(_good_value),
                func.max(_good_value),
                _good_count,
                func.min(SampleRow.quality),
            )
            .where(
                SampleRow.channel_id == channel_id,
                SampleRow.time_us >= begin_us,
                SampleRow.time_us < chunk_end_us,
            )
            .group_by(start)
            .order_by(start)
        )
        for time_us, mean, low, high, good, worst in connection.execute(query):
            quality = int(Quality.GOOD) if good else worst
            found.append((time_us, mean, low, high, good, quality))
        begin_us = chunk_end_us
    return found
