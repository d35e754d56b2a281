"""Rollups: statistics per minute and hour, kept up to date, and what is kept for how long."""

import math
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import Literal

import numpy as np
from sqlalchemy import Connection, delete, func, insert, select, tuple_, update

from service.clock import DAY_US, HOUR_US, MICROSECONDS, MINUTE_US
from service.store import buckets, hours, packed, rollup_blocks
from service.store.access_tables import AuditRow
from service.store.buckets import LEVELS_S
from service.store.database import Database, RollupColumns
from service.store.hours import (
    HourOfChannels,
    Portions,
    newest_in_table,
    oldest_in_table,
    owned_channels,
)
from service.store.part import StorePart
from service.store.rollup_blocks import SPANS_US, Buckets
from service.store.samples import Samples, raw_horizon_us
from service.store.tables import (
    AlarmTransitionRow,
    ChannelRow,
    PackedHourRow,
    RawHorizonRow,
    RetentionMarkRow,
    RollupRow,
    StaleRollupRow,
)

#: By default retention moves on by so much at a time: two looks of ten minutes, and an hour.
STEP_US = 20 * MINUTE_US + HOUR_US
#: A clock that is ahead of the last look by more needs a proof before anything is removed.
_GAP_US = 7 * 24 * HOUR_US
#: Marked hours that are looked up at a time.
_DUE = 50_000
#: Days of rows of an earlier version that the first transaction moves into blocks.
_FIRST_MOVES = 4
#: Blocks that are looked through at a time.
_BLOCKS = 100


@dataclass(frozen=True, slots=True)
class Retention:
    """Days for which each resolution is kept, None without limit; the others: 0.

    Raw samples that expire are condensed to seconds when those are kept longer.
    """

    raw_days: float | None = None
    second_days: float | None = None
    minute_days: float | None = None
    hour_days: float | None = None
    journal_days: float = 0.0
    audit_days: float = 0.0


@dataclass(frozen=True, slots=True)
class RetentionTime:
    """From when retention counts its days back, and by how much the clock is implausibly ahead.

    - ``at_us``: UTC microseconds; 0 when nothing is stored.
    - ``ahead_us``: how far the clock is ahead of the last look, where that needs a proof; else 0.
    """

    at_us: int
    ahead_us: int


class Rollups(StorePart):
    """Rollups of all channels. Hours that got samples are marked, and computed again later.

    ``samples``: learns what becomes of the raw samples that it has written.
    """

    def __init__(self, database: Database, samples: Samples) -> None:
        super().__init__(database)
        self._samples = samples
        self._portions = Portions()
        self._moves = Portions()
        self._moves.size = _FIRST_MOVES

    def refresh(self, before_us: int, owns: Callable[[str], bool] | None = None) -> int:
        """Compute rollups of marked hours that are over; each transaction is short.

        Later hours are still read from the raw samples, and so are marked ones: what is read is
        always right. Returns how many hours of channels were computed.

        - ``before_us``: only hours that ended by this time, UTC microseconds.
        - ``owns``: whether an asset is to be looked at; None: all are.
        """
        done = 0
        for hour_us, channel_ids in self._due(before_us, owns):
            left = sorted(channel_ids)
            while left:
                portion = left[: self._portions.size]
                with self._database.writing_samples() as connection:
                    taken, count = self._compute_portion(connection, portion, hour_us)
                left = left[taken:]
                done += count
        return done

    def pack_rows(
        self, until_s: float = math.inf, owns: Callable[[str], bool] | None = None
    ) -> int:
        """Move the oldest rows of each channel that an earlier version left into their block.

        Each transaction is short; it is as well to stop in between. Returns how many rows were
        moved; call again until it is 0.

        - ``until_s``: when to stop, on the monotonic clock.
        - ``owns``: whether an asset is to be looked at; None: all are.
        """
        moved = 0
        for resolution_s in SPANS_US:
            query = rollup_blocks.oldest_row(resolution_s)
            with self._database.reading() as connection:
                rows = connection.execute(query).all()
            left = [
                (number, time_us)
                for asset, number, time_us in rows
                if time_us is not None and (owns is None or owns(asset))
            ]
            while left and time.monotonic() < until_s:
                portion, left = left[: self._moves.size], left[self._moves.size :]
                with self._database.writing() as connection, self._moves.measured(len(portion)):
                    for number, time_us in portion:
                        moved += rollup_blocks.move_rows(connection, number, resolution_s, time_us)
        return moved

    def find_damage(self) -> str | None:
        """Look through all blocks; one line that says whose rollups are lost, or None."""
        assets: set[str] = set()
        after: rollup_blocks.Key | None = (-1, 0, 0)
        while after is not None:
            with self._database.reading() as connection:
                broken, after = rollup_blocks.damaged_assets(connection, after, _BLOCKS)
            assets |= broken
        if not assets:
            return None
        return (
            f"blocks of rollups are damaged: minutes or seconds of {', '.join(sorted(assets))} "
            "cannot be read where there are no samples any more; restore a backup if they are "
            "needed"
        )

    def _due(
        self, before_us: int, owns: Callable[[str], bool] | None
    ) -> Iterator[tuple[int, list[int]]]:
        """Find hours with the channels that are marked in them, oldest first."""
        hour_us, channel_id = StaleRollupRow.hour_us, StaleRollupRow.channel_id
        query = select(hour_us, channel_id).where(hour_us <= before_us - HOUR_US)
        query = query.order_by(hour_us, channel_id).limit(_DUE)
        after = (-1, -1)
        while True:
            with self._database.reading() as connection:
                rows = connection.execute(
                    query.where(tuple_(hour_us, channel_id) > tuple_(*after))
                ).all()
                ours = None if owns is None or not rows else owned_channels(connection, owns)
            for hour, marked in groupby(rows, itemgetter(0)):
                yield hour, [row[1] for row in marked if ours is None or row[1] in ours]
            if len(rows) < _DUE:
                return
            after = rows[-1][0], rows[-1][1]

    def _compute_portion(
        self, connection: Connection, channel_ids: list[int], hour_us: int
    ) -> tuple[int, int]:
        """Compute an hour of the first of some channels: how many of them, how many were due."""
        with self._portions.measured(len(channel_ids)):
            # What another program works on is left to it, and to the next look.
            this = (StaleRollupRow.channel_id.in_(channel_ids), StaleRollupRow.hour_us == hour_us)
            query = select(StaleRollupRow.channel_id).where(*this)
            due = sorted(connection.scalars(query.with_for_update(skip_locked=True)))
            if not due:
                return len(channel_ids), 0
            taken = _compute(connection, self._database, due, hour_us)
        if len(taken) == len(due):
            return len(channel_ids), len(due)
        return bisect_right(channel_ids, taken[-1]), len(taken)

    def retention_time(
        self,
        clock: Literal["process", "wall"],
        now_us: int,
        step_us: int = STEP_US,
        *,
        clock_proven: bool = False,
    ) -> "RetentionTime":
        """Move the time on from which retention counts its days back, and give it.

        It is never later than the clock nor than the newest sample or line that is stored, and
        moves on by ``step_us`` at a time at most: a clock that was wrong once costs little. When
        the clock is more than a week ahead of the look before, it stays where it is, unless the
        clock is proven.

        - ``clock``: "process" for samples and the journal, "wall" for the audit trail.
        - ``clock_proven``: a time server, or a person, vouches for the clock.
        """
        newest_us = _newest_us(self._database, clock)
        if newest_us is None:
            return RetentionTime(0, 0)
        with self._database.writing() as connection:
            target_us = min(now_us, newest_us)
            this = RetentionMarkRow.clock == clock
            mark_us = connection.scalar(select(RetentionMarkRow.time_us).where(this))
            if mark_us is None:
                mark_us = target_us
                connection.execute(insert(RetentionMarkRow).values(clock=clock, time_us=mark_us))
            elif target_us - mark_us > _GAP_US and not clock_proven:
                return RetentionTime(mark_us, target_us - mark_us)
            elif target_us > mark_us:
                mark_us = min(target_us, mark_us + step_us)
                connection.execute(update(RetentionMarkRow).where(this).values(time_us=mark_us))
        return RetentionTime(min(mark_us, target_us), 0)

    def confirm_clock(self, now_us: int, wall_now_us: int) -> None:
        """Let retention go on from the present times of the clocks, since a person says so."""
        for clock, time_us in (("process", now_us), ("wall", wall_now_us)):
            with self._database.writing() as connection:
                connection.execute(
                    update(RetentionMarkRow)
                    .where(RetentionMarkRow.clock == clock, RetentionMarkRow.time_us < time_us)
                    .values(time_us=time_us)
                )

    def lower_raw_horizon(self, time_us: int) -> int:
        """Take raw samples again from an earlier time on; returns the time before which none is.

        A later time than the present one changes nothing.
        """
        with self._database.writing() as connection:
            if time_us < raw_horizon_us(connection):
                _set_raw_horizon(connection, time_us)
            horizon_us = raw_horizon_us(connection)
            self._samples.keep_from(horizon_us)
        return horizon_us

    def expire(self, retention: Retention, now_us: int, step_us: int = STEP_US) -> int:
        """Remove what has been kept long enough; raw samples only once they are condensed."""
        return self.expire_at(retention, self.retention_time("process", now_us, step_us).at_us)

    def expire_at(self, retention: Retention, now_us: int) -> int:
        """As `expire`, counted from a time of `retention_time`."""
        removed = 0
        if retention.raw_days is not None:
            horizon_us = now_us - round(retention.raw_days * DAY_US)
            keeps_seconds = retention.second_days is None or (
                retention.second_days > retention.raw_days
            )
            removed += self._expire_raw(horizon_us - horizon_us % HOUR_US, keeps_seconds)
        for resolution_s, days in (
            (1, retention.second_days),
            (60, retention.minute_days),
            (600, retention.minute_days),
            (3600, retention.hour_days),
        ):
            if days is None:
                continue
            end_us = now_us - round(days * DAY_US)
            with self._database.writing() as connection:
                if resolution_s in SPANS_US:
                    removed += rollup_blocks.remove_before(connection, resolution_s, end_us)
                removed += connection.execute(
                    delete(RollupRow).where(
                        RollupRow.resolution_s == resolution_s,
                        RollupRow.time_us < end_us - end_us % HOUR_US,
                    )
                ).rowcount
        return removed

    def _expire_raw(self, horizon_us: int, keeps_seconds: bool) -> int:
        """Condense and remove hour after hour, so that new samples have their turn in between."""
        removed = 0
        while True:
            oldest_us = _oldest_us(self._database)
            if oldest_us is None or oldest_us >= horizon_us:
                return removed
            hour_us = oldest_us - oldest_us % HOUR_US
            with self._database.reading() as connection:
                left = list(connection.scalars(select(ChannelRow.id).order_by(ChannelRow.id)))
            while left:
                portion = left[: self._portions.size]
                with self._database.writing() as connection:
                    # First of all: what comes meanwhile for a channel that is done is too old.
                    # No further than what goes: whatever else is said to be old can still come.
                    if hour_us + HOUR_US > raw_horizon_us(connection):
                        _set_raw_horizon(connection, hour_us + HOUR_US)
                    self._samples.keep_from(raw_horizon_us(connection))
                    with self._portions.measured(len(portion)):
                        taken, count = self._condense(connection, portion, hour_us, keeps_seconds)
                left = left[bisect_right(left, taken[-1]) :]
                removed += count

    def _condense(
        self, connection: Connection, channel_ids: list[int], hour_us: int, keeps_seconds: bool
    ) -> tuple[list[int], int]:
        """Condense and remove an hour of the first of some channels: which ones, how many rows."""
        taken, found = hours.read(connection, self._database, channel_ids, hour_us)
        this = (StaleRollupRow.channel_id.in_(taken), StaleRollupRow.hour_us == hour_us)
        due = sorted(connection.scalars(select(StaleRollupRow.channel_id).where(*this)))
        while due:
            due = due[len(_compute(connection, self._database, due, hour_us)) :]
        if keeps_seconds:
            seconds = _columns(found, 1)
            rollup_blocks.put(connection, taken, 1, hour_us, seconds, replaces_hour=False)
        removed = hours.remove_from_table(connection, taken, hour_us)
        for hour in packed.hours_within(connection, taken, hour_us):
            removed += packed.remove(connection, hour.channel_id, hour_us)
        return taken, removed


def _oldest_us(database: Database) -> int | None:
    """Begin of the hour of the oldest sample."""
    firsts = oldest_in_table().subquery()
    with database.reading() as connection:
        found = (
            connection.scalar(select(func.min(firsts.c.time_us))),
            connection.scalar(select(func.min(PackedHourRow.hour_us))),
        )
    return min((one for one in found if one is not None), default=None)


def _newest_us(database: Database, clock: Literal["process", "wall"]) -> int | None:
    with database.reading() as connection:
        if clock == "wall":
            newest = select(AuditRow.time_us).order_by(AuditRow.id.desc()).limit(1)
            return connection.scalar(newest)
        lasts = newest_in_table().subquery()
        found = [
            connection.scalar(select(func.max(lasts.c.time_us))),
            connection.scalar(select(func.max(AlarmTransitionRow.time_us))),
        ]
        if (hour_us := connection.scalar(select(func.max(PackedHourRow.hour_us)))) is not None:
            last = select(func.max(PackedHourRow.last_us)).where(PackedHourRow.hour_us == hour_us)
            found.append(connection.scalar(last))
    return max((one for one in found if one is not None), default=None)


def _compute(
    connection: Connection, database: Database, channel_ids: list[int], hour_us: int
) -> list[int]:
    """Compute the rollups of an hour of the first of some channels; which ones."""
    taken, found = hours.read(connection, database, channel_ids, hour_us)
    minutes = _columns(found, 60)
    rollup_blocks.put(connection, taken, 60, hour_us, minutes, replaces_hour=True)
    connection.execute(
        delete(RollupRow).where(
            RollupRow.channel_id.in_(taken),
            RollupRow.resolution_s.in_(LEVELS_S),
            RollupRow.time_us >= hour_us,
            RollupRow.time_us < hour_us + HOUR_US,
        )
    )
    connection.execute(
        delete(StaleRollupRow).where(
            StaleRollupRow.channel_id.in_(taken), StaleRollupRow.hour_us == hour_us
        )
    )
    if found.channel_ids.size:
        one = buckets.statistics(found.samples, HOUR_US, channel_ids=found.channel_ids)
        columns = RollupColumns(
            found.channel_ids[one.first],
            np.full(one.first.size, HOUR_US // MICROSECONDS),
            *one.buckets,
        )
        database.dialect.insert_rollups(connection, columns)
    return taken


def _columns(found: HourOfChannels, resolution_s: int) -> dict[int, Buckets]:
    """Compute the buckets of an hour of channels, those of each channel apart."""
    ids = found.channel_ids
    if not ids.size:
        return {}
    first, every, _ = buckets.statistics(
        found.samples, resolution_s * MICROSECONDS, channel_ids=ids
    )
    ids = ids[first]
    begins = np.flatnonzero(np.diff(ids, prepend=-1))
    ends = [*begins[1:].tolist(), ids.size]
    return {
        int(ids[begin]): every.taken(slice(begin, end))
        for begin, end in zip(begins.tolist(), ends, strict=True)
    }


def _set_raw_horizon(connection: Connection, time_us: int) -> None:
    """Remember that raw samples before a time are not kept any more."""
    if not connection.execute(update(RawHorizonRow).values(time_us=time_us)).rowcount:
        connection.execute(insert(RawHorizonRow).values(id=1, time_us=time_us))
