"""The history of one channel as a historian reads it: samples, values at times, intervals."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, Select, select

from service.clock import HOUR_US, MINUTE_US
from service.store import buckets, packed
from service.store.blocks import UNKNOWN_US, ChannelSamples
from service.store.buckets import Bucket
from service.store.history import chunk, seconds
from service.store.part import StorePart
from service.store.samples import channel_ids, raw_horizon_us
from service.store.tables import SampleRow

#: A value is the one of a later time too, at most so long.
HELD_US: Final = HOUR_US
_UNITS_US: Final = (HOUR_US, MINUTE_US)


class ChannelHistory(StorePart):
    """Reads one channel of one asset at a time; a channel that was never stored has nothing."""

    def samples(
        self, asset: str, channel: str, begin_us: int, end_us: int, limit: int
    ) -> ChannelSamples:
        """Give the first raw samples of a span, ascending by time, whatever their quality.

        ``begin_us``, ``end_us``: UTC microseconds; the begin is included, the end is not.
        """
        with self._database.reading() as connection:
            number = _number(connection, asset, channel)
            if number is None:
                return _joined([])
            rows = _table_rows(connection, number, begin_us, end_us, limit)
            until_us = int(rows.times_us[-1]) if rows.times_us.size == limit else end_us
            found, count = [rows], 0
            for hour in packed.read(connection, number, begin_us, until_us):
                found.append(hour)
                count += hour.times_us.size
                if count >= limit:
                    break
        return _joined(found).taken(slice(0, limit))

    def differing(
        self, asset: str, channel: str, times_us: NDArray[np.int64], values: NDArray[np.float64]
    ) -> dict[int, float]:
        """Find the samples for which the store has another value at exactly their time.

        Returns the stored value by place in the arrays.
        """
        found: dict[int, float] = {}
        order = np.argsort(times_us, kind="stable")
        ordered_us = times_us[order]
        hours = np.unique(ordered_us // HOUR_US)
        with self._database.reading() as connection:
            number = _number(connection, asset, channel)
            if number is None:
                return found
            for run in np.split(hours, np.flatnonzero(np.diff(hours) > 1) + 1):
                begin_us, end_us = int(run[0]) * HOUR_US, int(run[-1] + 1) * HOUR_US
                first, last = np.searchsorted(ordered_us, (begin_us, end_us))
                stored = _raw(connection, number, begin_us, end_us)
                places = np.searchsorted(stored.times_us, ordered_us[first:last])
                for at, place in zip(order[first:last].tolist(), places.tolist(), strict=True):
                    if place == stored.times_us.size or stored.times_us[place] != times_us[at]:
                        continue
                    value = float(stored.values[place])
                    if not math.isnan(value) and value != values[at]:
                        found[at] = value
        return found

    def last_samples(
        self, asset: str, channel: str, begin_us: int, end_us: int, limit: int
    ) -> ChannelSamples:
        """Give the last raw samples of a span, ascending by time; parameters as of `samples`."""
        found: list[ChannelSamples] = []
        count = 0
        with self._database.reading() as connection:
            number = _number(connection, asset, channel)
            last_us = None if number is None else _last_us(connection, number, end_us)
            while number is not None and last_us is not None and last_us >= begin_us:
                hour_us = max(last_us - last_us % HOUR_US, begin_us)
                part = _raw(connection, number, hour_us, last_us + 1)
                found.append(part)
                count += part.times_us.size
                if count >= limit:
                    break
                last_us = _last_us(connection, number, hour_us)
        every = _joined(found)
        return every.taken(slice(max(every.times_us.size - limit, 0), None))

    def at_times(self, asset: str, channel: str, times_us: Sequence[int]) -> ChannelSamples:
        """Give the value that a channel has at each of some times: the last one up to then.

        Where there is none within `HELD_US` before, time is -1 and quality 0.
        """
        wanted = np.asarray(times_us, dtype=np.int64)
        order = np.argsort(wanted, kind="stable")
        found = ChannelSamples(
            np.full(wanted.size, -1, np.int64),
            np.full(wanted.size, np.nan),
            np.zeros(wanted.size, np.uint16),
            np.full(wanted.size, UNKNOWN_US, np.int64),
        )
        with self._database.reading() as connection:
            number = _number(connection, asset, channel)
            if number is None:
                return found
            for group in _groups(wanted[order]):
                places = order[group]
                asked_us = wanted[places]
                first_us, last_us = int(asked_us[0]), int(asked_us[-1])
                held_us = _last_us(connection, number, first_us + 1) or first_us
                raw = _raw(connection, number, max(held_us, first_us - HELD_US), last_us + 1)
                at = np.searchsorted(raw.times_us, asked_us, side="right") - 1
                known = at >= 0
                known[known] = asked_us[known] - raw.times_us[at[known]] <= HELD_US
                found.times_us[places[known]] = raw.times_us[at[known]]
                found.values[places[known]] = raw.values[at[known]]
                found.qualities[places[known]] = raw.qualities[at[known]]
        return found

    def intervals(
        self, asset: str, channel: str, begin_us: int, interval_us: int, count: int
    ) -> list[Bucket]:
        """Give the statistics of the good samples per interval.

        Whole hours and minutes inside an interval come from the rollups, so that a long one costs
        little; what is left at its ends from the raw samples, or where these are not kept any more
        from statistics per second. They ascend by time; intervals without any sample are absent.

        - ``begin_us``: begin of the first interval, UTC microseconds, of any second or part of one.
        - ``interval_us``: length of an interval, positive.
        """
        end_us = begin_us + count * interval_us
        with self._database.reading() as connection:
            number = _number(connection, asset, channel)
            if number is None:
                return []
            horizon_us = raw_horizon_us(connection)
            parts: list[Bucket] = []
            if interval_us >= HOUR_US:
                for start_us in range(begin_us, end_us, interval_us):
                    spread = _spread(
                        connection, number, start_us, start_us + interval_us, horizon_us
                    )
                    parts += [part._replace(time_us=start_us) for part in spread]
                return buckets.merged(parts)
            if begin_us % MINUTE_US == 0 and interval_us % MINUTE_US == 0:
                parts = chunk(connection, number, begin_us, end_us, MINUTE_US, horizon_us)
            else:
                parts = _fine(connection, number, begin_us, end_us, interval_us, horizon_us)
        return buckets.merged(
            part._replace(time_us=part.time_us - (part.time_us - begin_us) % interval_us)
            for part in parts
        )


def _number(connection: Connection, asset: str, channel: str) -> int | None:
    return channel_ids(connection, asset, [channel]).get(channel)


def _table_rows(
    connection: Connection, number: int, begin_us: int, end_us: int, limit: int | None
) -> ChannelSamples:
    query: Select[int, float | None, int] = (
        select(SampleRow.time_us, SampleRow.value, SampleRow.quality)
        .where(*_inside(number, begin_us, end_us))
        .order_by(SampleRow.time_us)
        .limit(limit)
    )
    rows = connection.execute(query).all()
    times_us, values, qualities = zip(*rows, strict=True) if rows else ((), (), ())
    return ChannelSamples(
        np.array(times_us, np.int64),
        np.array(values, np.float64),  # None is not a number
        np.array(qualities, np.uint16),
        np.full(len(rows), UNKNOWN_US, np.int64),
    )


def _inside(number: int, begin_us: int, end_us: int) -> tuple[ColumnElement[bool], ...]:
    return (
        SampleRow.channel_id == number,
        SampleRow.time_us >= begin_us,
        SampleRow.time_us < end_us,
    )


def _raw(connection: Connection, number: int, begin_us: int, end_us: int) -> ChannelSamples:
    parts = [_table_rows(connection, number, begin_us, end_us, None)]
    return _joined([*parts, *packed.read(connection, number, begin_us, end_us)])


def _joined(parts: Sequence[ChannelSamples]) -> ChannelSamples:
    """Join parts that have no time in common; ascending by time."""
    if not parts:
        nothing = np.empty(0, np.int64)
        return ChannelSamples(nothing, np.empty(0), np.empty(0, np.uint16), nothing)
    times_us, values, qualities, received_us = (
        np.concatenate([part.times_us for part in parts]),
        np.concatenate([part.values for part in parts]),
        np.concatenate([part.qualities for part in parts]),
        np.concatenate([part.received_us for part in parts]),
    )
    order = np.argsort(times_us, kind="stable")
    return ChannelSamples(times_us[order], values[order], qualities[order], received_us[order])


def _last_us(connection: Connection, number: int, end_us: int) -> int | None:
    """Time of the last sample before a time."""
    query = select(SampleRow.time_us).where(*_inside(number, 0, end_us))
    from_table = connection.scalar(query.order_by(SampleRow.time_us.desc()).limit(1))
    from_blocks = packed.last_time_us(connection, number, end_us)
    return max((one for one in (from_table, from_blocks) if one is not None), default=None)


def _groups(times_us: NDArray[np.int64]) -> Iterator[slice]:
    """Slices of ascending times that lie so close that they are read at once."""
    if not times_us.size:
        return
    ends = [*(np.flatnonzero(np.diff(times_us) > MINUTE_US) + 1).tolist(), times_us.size]
    begin = 0
    for end in ends:
        yield slice(begin, end)
        begin = end


def _spread(
    connection: Connection,
    number: int,
    begin_us: int,
    end_us: int,
    horizon_us: int,
    units_us: Sequence[int] = _UNITS_US,
) -> list[Bucket]:
    """Give parts of one interval: its whole hours, then whole minutes, then what is left."""
    if begin_us >= end_us:
        return []
    if not units_us:
        return _fine(connection, number, begin_us, end_us, end_us - begin_us, horizon_us)
    unit_us, *finer = units_us
    low_us, high_us = -(-begin_us // unit_us) * unit_us, end_us - end_us % unit_us
    if low_us >= high_us:
        return _spread(connection, number, begin_us, end_us, horizon_us, finer)
    return [
        *_spread(connection, number, begin_us, low_us, horizon_us, finer),
        *chunk(connection, number, low_us, high_us, unit_us, horizon_us),
        *_spread(connection, number, high_us, end_us, horizon_us, finer),
    ]


def _fine(
    connection: Connection,
    number: int,
    begin_us: int,
    end_us: int,
    interval_us: int,
    horizon_us: int,
) -> list[Bucket]:
    """Parts of intervals from raw samples, and before these from statistics per second."""
    raw = _raw(connection, number, max(begin_us, horizon_us), end_us)
    parts = [one for one, _ in buckets.of_block(raw, interval_us, begin_us)]
    if begin_us < horizon_us:
        parts += seconds(connection, number, begin_us, min(end_us, horizon_us), 1_000_000)
    return parts
