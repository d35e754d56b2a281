"""Rollups: statistics per minute and hour, kept up to date, and what is kept for how long."""

from dataclasses import dataclass
from typing import Literal

from sqlalchemy import Connection, delete, func, insert, select, update

from service.clock import DAY_US, HOUR_US, MINUTE_US
from service.store import buckets, packed
from service.store.buckets import LEVELS_S
from service.store.database import Database
from service.store.part import StorePart
from service.store.samples import Samples, first_time_us, last_time_us, raw_horizon_us
from service.store.tables import (
    AlarmTransitionRow,
    AuditRow,
    ChannelRow,
    RawHorizonRow,
    RetentionMarkRow,
    RollupRow,
    SampleRow,
    StaleRollupRow,
)

#: By default retention moves on by so much at a time: two looks of ten minutes, and an hour.
STEP_US = 20 * MINUTE_US + HOUR_US
#: A clock that is ahead of the last look by more needs a proof before anything is removed.
_GAP_US = 7 * 24 * HOUR_US
_COLUMNS = ("channel_id", "resolution_s", "time_us", "mean", "low", "high", "good", "quality")


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
    forecast_days: float = 0.0


@dataclass(frozen=True, slots=True)
class RetentionTime:
    """From when retention counts its days back, and by how much the clock is implausibly ahead.

    Attributes
    ----------
    at_us : int
        UTC microseconds; 0 when nothing is stored.
    ahead_us : int
        How far the clock is ahead of the last look, where that needs a proof; else 0.
    """

    at_us: int
    ahead_us: int


class Rollups(StorePart):
    """Rollups of all channels. Hours that got samples are marked, and computed again later.

    Parameters
    ----------
    database : Database
        The store's.
    samples : Samples
        Is told what becomes of the raw samples that it has written.
    """

    def __init__(self, database: Database, samples: Samples) -> None:
        super().__init__(database)
        self._samples = samples

    def refresh(self, before_us: int, limit: int = 200) -> int:
        """Compute rollups of marked hours that are over; each hour is a short transaction.

        Parameters
        ----------
        before_us : int
            Only hours that ended by this time, UTC microseconds. Later ones are still read from
            the raw samples, and so are marked ones: what is read is always right.
        limit : int
            Hours of channels at most.

        Returns
        -------
        int
            Hours of channels that were computed; call again while it equals ``limit``.
        """
        query = (
            select(StaleRollupRow.channel_id, StaleRollupRow.hour_us)
            .where(StaleRollupRow.hour_us <= before_us - HOUR_US)
            .order_by(StaleRollupRow.hour_us)
            .limit(limit)
        )
        with self._database.reading() as connection:
            hours = [(channel_id, hour_us) for channel_id, hour_us in connection.execute(query)]
        for channel_id, hour_us in hours:
            with self._database.writing() as connection:
                _compute(connection, channel_id, hour_us)
        return len(hours)

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

        Parameters
        ----------
        clock : str
            "process" for samples and the journal, "wall" for the audit trail.
        now_us : int
            What that clock shows, UTC microseconds.
        step_us : int
            How far it moves at most.
        clock_proven : bool
            A time server, or a person, vouches for the clock.
        """
        with self._database.writing() as connection:
            newest_us = _newest_us(connection, clock)
            if newest_us is None:
                return RetentionTime(0, 0)
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
        """Remove what has been kept long enough; raw samples only once they are condensed.

        Parameters
        ----------
        retention : Retention
            How long each resolution is kept.
        now_us : int
            Process time, UTC microseconds; see `retention_time`.
        step_us : int
            How far retention may move on.

        Returns
        -------
        int
            Rows that were removed.
        """
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
            with self._database.writing() as connection:
                oldest_us = _oldest_us(connection)
                if oldest_us is None or oldest_us >= horizon_us:
                    return removed
                hour_us = oldest_us - oldest_us % HOUR_US
                removed += self._condense(connection, hour_us, keeps_seconds)
                # No further than what is gone: whatever else is said to be old can still come.
                if hour_us + HOUR_US > raw_horizon_us(connection):
                    _set_raw_horizon(connection, hour_us + HOUR_US)
                self._samples.keep_from(raw_horizon_us(connection))

    def _condense(self, connection: Connection, hour_us: int, keeps_seconds: bool) -> int:
        in_hour = (SampleRow.time_us >= hour_us, SampleRow.time_us < hour_us + HOUR_US)
        for channel_id in connection.scalars(select(ChannelRow.id)).all():
            _compute(connection, channel_id, hour_us)
            if keeps_seconds:
                _insert(connection, channel_id, 1, hour_us, hour_us + HOUR_US)
        removed = 0
        for channel_id in connection.scalars(select(ChannelRow.id)).all():
            removed += connection.execute(
                delete(SampleRow).where(SampleRow.channel_id == channel_id, *in_hour)
            ).rowcount
            removed += packed.remove(connection, channel_id, hour_us)
        return removed


def _oldest_us(connection: Connection) -> int | None:
    # One look per channel at the primary key; a plain minimum would read all samples.
    firsts = (
        first_time_us(connection, channel_id, 0)
        for channel_id in connection.scalars(select(ChannelRow.id)).all()
    )
    return min((first for first in firsts if first is not None), default=None)


def _newest_us(connection: Connection, clock: Literal["process", "wall"]) -> int | None:
    if clock == "wall":
        newest = select(AuditRow.time_us).order_by(AuditRow.id.desc()).limit(1)
        return connection.scalar(newest)
    lasts = [
        last_time_us(connection, channel_id)
        for channel_id in connection.scalars(select(ChannelRow.id)).all()
    ]
    lasts.append(connection.scalar(select(func.max(AlarmTransitionRow.time_us))))
    return max((last for last in lasts if last is not None), default=None)


def _compute(connection: Connection, channel_id: int, hour_us: int) -> None:
    this_hour = (StaleRollupRow.channel_id == channel_id, StaleRollupRow.hour_us == hour_us)
    if not connection.scalar(select(func.count()).select_from(StaleRollupRow).where(*this_hour)):
        return  # another program was here
    connection.execute(
        delete(RollupRow).where(
            RollupRow.channel_id == channel_id,
            RollupRow.resolution_s > 1,
            RollupRow.time_us >= hour_us,
            RollupRow.time_us < hour_us + HOUR_US,
        )
    )
    for resolution_s in LEVELS_S:
        _insert(connection, channel_id, resolution_s, hour_us, hour_us + HOUR_US)
    connection.execute(delete(StaleRollupRow).where(*this_hour))


def _insert(
    connection: Connection, channel_id: int, resolution_s: int, begin_us: int, end_us: int
) -> None:
    bucket_us = resolution_s * MINUTE_US // 60
    found = buckets.of_raw(connection, channel_id, begin_us, end_us, bucket_us)
    if found:
        connection.execute(
            insert(RollupRow),
            [
                dict(zip(_COLUMNS, (channel_id, resolution_s, *bucket), strict=True))
                for bucket in found
            ],
        )


def _set_raw_horizon(connection: Connection, time_us: int) -> None:
    """Remember that raw samples before a time are not kept any more."""
    if not connection.execute(update(RawHorizonRow).values(time_us=time_us)).rowcount:
        connection.execute(insert(RawHorizonRow).values(id=1, time_us=time_us))
