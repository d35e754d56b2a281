"""Statistics of the samples per bucket of time: rollups for people, minutes for the twin."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from sqlalchemy import Connection, func, select

from service.clock import HOUR_US, MINUTE_US
from service.store import buckets, packed, rollup_blocks
from service.store.buckets import LEVELS_S, Bucket
from service.store.merging import merged
from service.store.part import StorePart, rows_of
from service.store.records import MinuteTable, Rollup
from service.store.samples import channel_ids, first_time_us, raw_horizon_us
from service.store.tables import ChannelRow, RollupRow, SampleRow, StaleRollupRow

_SECOND_US = 1_000_000
#: `Rollup._make` would be a step of the program for each.
_rollup = partial(tuple.__new__, Rollup)


class History(StorePart):
    """Taken from the rollups where they are up to date, else computed from the raw samples."""

    def read(
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

        - ``start_us``, ``end_us``: UTC microseconds; the start is included, the end is not.
        - ``bucket_us``: length of a bucket; buckets are counted from the epoch.
        - ``after``: time and channel of the last rollup of the page before: go on behind it.
        """
        if bucket_us <= 0:
            raise ValueError(f"bucket_us = {bucket_us}: expected a positive number")
        first_us = -(-max(start_us, 0) // bucket_us) * bucket_us
        end_us = -(-end_us // bucket_us) * bucket_us
        with self._database.reading() as connection:
            ids = channel_ids(connection, asset, channels)
            horizon_us = raw_horizon_us(connection)

            def read(name: str, from_us: int, count: int) -> list[Rollup]:
                rows = _read(connection, ids[name], from_us, end_us, bucket_us, horizon_us, count)
                return [_rollup((name, *row)) for row in rows]

            def begin_us(name: str) -> int:
                if after is None:
                    return first_us
                return max(first_us, after[0] + bucket_us * (name <= after[1]))

            return merged(ids, read, lambda row: row.time_us + bucket_us, begin_us, limit)

    def minute_averages(
        self,
        asset: str,
        channels: Sequence[str],
        start_us: int,
        end_us: int,
        offset_us: int = 0,
        step_us: int = MINUTE_US,
    ) -> MinuteTable:
        """Averages per minute of the good samples, on one time axis for all channels.

        - ``channels``: which channels; one that was never stored is all NaN.
        - ``start_us``, ``end_us``: UTC microseconds; samples in the half-open span count.
        - ``offset_us``: minutes begin so much after the full minute; minus half a minute centres
          the averages on the full minutes, as an instantaneous value there.
        """
        per_channel: dict[str, list[tuple[int, float | None, int, int]]] = {}
        with self._database.reading() as connection:
            ids = channel_ids(connection, asset, channels)
            for name, channel_id in ids.items():
                time_us = SampleRow.time_us.expression
                minute = buckets.bucket_start(time_us, step_us, offset_us)
                query = select(
                    minute, buckets.mean_of_good, buckets.count_of_good, func.count()
                ).where(
                    SampleRow.channel_id == channel_id,
                    SampleRow.time_us >= start_us,
                    SampleRow.time_us < end_us,
                )
                rows: list[tuple[int, float | None, int, int]] = [
                    (time_us, mean, good, count)
                    for time_us, mean, good, count in connection.execute(query.group_by(minute))
                ]
                for samples in packed.read(connection, channel_id, start_us, end_us):
                    rows += [
                        (bucket.time_us, bucket.mean, bucket.good, count)
                        for bucket, count in buckets.of_block(samples, step_us, offset_us)
                    ]
                per_channel[name] = _joined(rows)
        minute_us = np.array(
            sorted({row[0] for rows in per_channel.values() for row in rows}), dtype=np.int64
        )
        table = MinuteTable(minute_us, mean={}, good_count={}, bad_count={})
        for name in channels:
            mean = np.full(minute_us.size, np.nan)
            good = np.zeros(minute_us.size, dtype=np.int64)
            bad = np.zeros(minute_us.size, dtype=np.int64)
            if found := per_channel.get(name):
                times, means, goods, counts = zip(*found, strict=True)
                at = np.searchsorted(minute_us, np.array(times, dtype=np.int64))
                mean[at] = [np.nan if value is None else value for value in means]
                good[at] = goods
                bad[at] = np.array(counts, dtype=np.int64) - np.array(goods, dtype=np.int64)
            table.mean[name] = mean
            table.good_count[name] = good
            table.bad_count[name] = bad
        return table

    def recent_minute_means(
        self, channels: Mapping[str, Sequence[str]], start_us: int, end_us: int
    ) -> dict[tuple[str, str], dict[int, float]]:
        """Means of the good samples per minute, of many assets at once.

        Only for the last hour: what is packed is left out. Minutes without any sample are absent.

        - ``start_us``, ``end_us``: UTC microseconds, of full minutes; the start is included, the
          end is not.
        """
        found: dict[tuple[str, str], dict[int, float]] = {
            (asset, name): {} for asset, names in channels.items() for name in names
        }
        minute = buckets.bucket_start(SampleRow.time_us.expression, MINUTE_US, 0)
        query = (
            select(SampleRow.channel_id, minute, buckets.mean_of_good)
            .where(SampleRow.time_us >= start_us, SampleRow.time_us < end_us)
            .group_by(SampleRow.channel_id, minute)
        )
        known = select(ChannelRow.id, ChannelRow.asset, ChannelRow.name)
        with self._database.reading() as connection:
            rows = rows_of(connection, ChannelRow.asset, known, channels)
            names = {row.id: (row.asset, row.name) for row in rows}
            ids = [number for number, name in names.items() if name in found]
            for number, minute_us, mean in rows_of(connection, SampleRow.channel_id, query, ids):
                if mean is not None:
                    found[names[number]][minute_us] = mean
        return found


def _joined(
    rows: list[tuple[int, float | None, int, int]],
) -> list[tuple[int, float | None, int, int]]:
    """Join the parts of a minute that reaches over the end of an hour: mean, good ones, all."""
    minutes: dict[int, tuple[int, float | None, int, int]] = {}
    for row in rows:
        time_us, mean, good, count = row
        if time_us not in minutes:
            minutes[time_us] = row
            continue
        _, other_mean, other_good, other_count = minutes[time_us]
        total = (mean or 0.0) * good + (other_mean or 0.0) * other_good
        both = good + other_good
        minutes[time_us] = (time_us, total / both if both else None, both, count + other_count)
    return list(minutes.values())


def _read(
    connection: Connection,
    channel_id: int,
    begin_us: int,
    end_us: int,
    bucket_us: int,
    horizon_us: int,
    limit: int,
) -> list[Bucket]:
    """Read the first ``limit`` buckets of a channel; gaps are jumped over, not walked through."""
    if end_us - begin_us <= limit * bucket_us:
        return chunk(connection, channel_id, begin_us, end_us, bucket_us, horizon_us)
    found: list[Bucket] = []
    while len(found) < limit:
        first_us = _first_us(connection, channel_id, begin_us, horizon_us)
        if first_us is None or first_us >= end_us:
            break
        begin_us = first_us - first_us % bucket_us
        chunk_end_us = min(begin_us + (limit - len(found)) * bucket_us, end_us)
        found += chunk(connection, channel_id, begin_us, chunk_end_us, bucket_us, horizon_us)
        begin_us = chunk_end_us
    return found


def chunk(
    connection: Connection,
    channel_id: int,
    begin_us: int,
    end_us: int,
    bucket_us: int,
    horizon_us: int,
) -> list[Bucket]:
    """All buckets of a span of whole buckets."""

    def raw(from_us: int, to_us: int) -> list[Bucket]:
        return buckets.of_raw(connection, channel_id, from_us, to_us, bucket_us)

    def rows(resolution_s: int, from_us: int, to_us: int) -> list[Bucket]:
        query = buckets.of_rollups(channel_id, resolution_s, from_us, to_us, bucket_us)
        return buckets.read(connection, query)

    if bucket_us % MINUTE_US:
        parts = raw(max(begin_us, horizon_us), end_us)
        if begin_us < horizon_us and bucket_us % _SECOND_US == 0:
            parts += seconds(connection, channel_id, begin_us, min(end_us, horizon_us), bucket_us)
        return buckets.merged(parts)
    resolution_s = next(one for one in LEVELS_S if bucket_us % (one * _SECOND_US) == 0)
    stale = list(
        connection.scalars(
            select(StaleRollupRow.hour_us)
            .where(
                StaleRollupRow.channel_id == channel_id,
                StaleRollupRow.hour_us > begin_us - HOUR_US,
                StaleRollupRow.hour_us < end_us,
            )
            .order_by(StaleRollupRow.hour_us)
        )
    )
    parts = []
    if resolution_s < HOUR_US // _SECOND_US:
        parts, lost_us = _packed_minutes(connection, channel_id, begin_us, end_us, bucket_us, stale)
        stale = sorted({*stale, *lost_us})
    at_us = begin_us
    for from_us, to_us in _runs(stale):
        parts += rows(resolution_s, at_us, max(from_us, at_us))
        parts += raw(max(from_us, at_us), min(to_us, end_us))
        at_us = min(to_us, end_us)
    parts += rows(resolution_s, at_us, end_us)
    return buckets.merged(parts)


def seconds(
    connection: Connection, channel_id: int, begin_us: int, end_us: int, bucket_us: int
) -> list[Bucket]:
    """Buckets of a span from the statistics per second, where raw samples are not kept."""
    query = buckets.of_rollups(channel_id, 1, begin_us, end_us, bucket_us)
    parts = buckets.read(connection, query)
    for _, found in rollup_blocks.read(connection, channel_id, 1, begin_us, end_us):
        if found is not None:
            parts += buckets.listed(buckets.joined(found, bucket_us))
    return parts


def _packed_minutes(
    connection: Connection,
    channel_id: int,
    begin_us: int,
    end_us: int,
    bucket_us: int,
    stale_us: Sequence[int],
) -> tuple[list[Bucket], list[int]]:
    """Buckets of a span from blocks of minutes but for those of stale hours.

    Returns also the hours of damaged blocks: there may still be samples of them.
    """
    parts: list[Bucket] = []
    lost_us: list[int] = []
    for block_us, minutes in rollup_blocks.read(connection, channel_id, 60, begin_us, end_us):
        if minutes is None:
            lost = range(block_us, block_us + rollup_blocks.SPANS_US[60], HOUR_US)
            lost_us += [one for one in lost if begin_us - HOUR_US < one < end_us]
            continue
        if stale_us:
            hours_us = minutes.times_us - minutes.times_us % HOUR_US
            minutes = minutes.taken(~np.isin(hours_us, stale_us))
        parts += buckets.listed(buckets.joined(minutes, bucket_us))
    return parts, lost_us


def _runs(hours_us: Sequence[int]) -> list[tuple[int, int]]:
    """Join hours that follow each other into spans."""
    runs: list[tuple[int, int]] = []
    for hour_us in hours_us:
        if runs and runs[-1][1] == hour_us:
            runs[-1] = (runs[-1][0], hour_us + HOUR_US)
        else:
            runs.append((hour_us, hour_us + HOUR_US))
    return runs


def _first_us(
    connection: Connection, channel_id: int, begin_us: int, horizon_us: int
) -> int | None:
    """Time of the first sample, or of the first rollup where samples are not kept."""
    first_us = first_time_us(connection, channel_id, max(begin_us, horizon_us))
    if begin_us >= horizon_us:
        return first_us
    condensed = connection.scalar(
        select(RollupRow.time_us)
        .where(
            RollupRow.channel_id == channel_id,
            RollupRow.resolution_s == 3600,
            RollupRow.time_us > begin_us - HOUR_US,
            RollupRow.time_us < horizon_us,
        )
        .order_by(RollupRow.time_us)
        .limit(1)
    )
    return first_us if condensed is None else max(condensed, begin_us)
