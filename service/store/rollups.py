"""Rollups: statistics per minute and hour, kept up to date, and what is kept for how long."""

from dataclasses import dataclass

from sqlalchemy import Connection, delete, func, insert, select, update

from service.store import buckets
from service.store.buckets import HOUR_US, LEVELS_S, MINUTE_US
from service.store.samples import Samples, first_time_us, raw_horizon_us
from service.store.tables import ChannelRow, RawHorizonRow, RollupRow, SampleRow, StaleRollupRow

_DAY_US = 24 * HOUR_US
_COLUMNS = ("channel_id", "resolution_s", "time_us", "mean", "low", "high", "good", "quality")


@dataclass(frozen=True, slots=True)
class Retention:
    """Days for which each resolution is kept, None for ever; journal and audit trail: 0.

    Raw samples that expire are condensed to seconds when those are kept longer.
    """

    raw_days: float | None = None
    second_days: float | None = None
    minute_days: float | None = None
    hour_days: float | None = None
    journal_days: float = 0.0
    audit_days: float = 0.0


class Rollups(Samples):
    """Rollups of all channels. Hours that got samples are marked, and computed again later."""

    def refresh_rollups(self, before_us: int, limit: int = 200) -> int:
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
                # From here on a new sample marks the hour again.
                self._stale.discard((channel_id, hour_us))
        return len(hours)

    def expire(self, retention: Retention, now_us: int) -> int:
        """Remove what has been kept long enough; raw samples only once they are condensed.

        Parameters
        ----------
        retention : Retention
            How long each resolution is kept.
        now_us : int
            Process time, UTC microseconds.

        Returns
        -------
        int
            Rows that were removed.
        """
        removed = 0
        if retention.raw_days is not None:
            horizon_us = now_us - round(retention.raw_days * _DAY_US)
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
            end_us = now_us - round(days * _DAY_US)
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
                known_us = raw_horizon_us(connection)
                oldest_us = _oldest_us(connection)
                if horizon_us <= known_us:
                    return removed
                if oldest_us is None or oldest_us >= horizon_us:
                    _set_raw_horizon(connection, horizon_us)
                    return removed
                hour_us = oldest_us - oldest_us % HOUR_US
                removed += self._condense(connection, hour_us, keeps_seconds)
                _set_raw_horizon(connection, hour_us + HOUR_US)

    def _condense(self, connection: Connection, hour_us: int, keeps_seconds: bool) -> int:
        in_hour = (SampleRow.time_us >= hour_us, SampleRow.time_us < hour_us + HOUR_US)
        for channel_id in connection.scalars(select(ChannelRow.id)).all():
            _compute(connection, channel_id, hour_us)
            self._stale.discard((channel_id, hour_us))
            if keeps_seconds:
                _insert(connection, channel_id, 1, hour_us, hour_us + HOUR_US)
        removed = 0
        for channel_id in connection.scalars(select(ChannelRow.id)).all():
            removed += connection.execute(
                delete(SampleRow).where(SampleRow.channel_id == channel_id, *in_hour)
            ).rowcount
        return removed


def _oldest_us(connection: Connection) -> int | None:
    # One look per channel at the primary key; a plain minimum would read all samples.
    firsts = (
        first_time_us(connection, channel_id, 0)
        for channel_id in connection.scalars(select(ChannelRow.id)).all()
    )
    return min((first for first in firsts if first is not None), default=None)


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
    query = buckets.of_samples(channel_id, begin_us, end_us, resolution_s * MINUTE_US // 60)
    found = buckets.read(connection, query)
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
