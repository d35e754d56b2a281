"""Raw samples: written in batches, each time of a channel once, read in order."""

import math
from collections.abc import Collection, Iterable, Sequence
from contextlib import AbstractContextManager
from operator import itemgetter
from typing import Any, NoReturn

from sqlalchemy import Connection, Row, func, insert, select
from sqlalchemy.exc import IntegrityError

from adapters.samples import Quality, Sample, is_bad, is_good
from service.clock import HOUR_US
from service.store import packed
from service.store.database import (
    PATIENCE_S,
    AloneNeededError,
    Database,
    SampleColumns,
    chosen,
    require_alone,
)
from service.store.errors import StoreUnavailableError
from service.store.merging import merged
from service.store.packing import merge_late
from service.store.part import StorePart, rows_of
from service.store.records import StoredSample, WriteCounts
from service.store.tables import ChannelRow, RawHorizonRow, SampleRow

_CHANNEL_IDS = "bearing_twin_channel_ids"
_LONG = 2**63
_LATER_US = _LONG - 1
_BYTES = frozenset(range(256))


class Samples(StorePart):
    """Raw samples of all channels of all assets."""

    def __init__(self, database: Database) -> None:
        super().__init__(database)
        self._kept_from_us: int | None = None

    def write(self, samples: Collection[Sample], patience_s: float = PATIENCE_S) -> WriteCounts:
        """Store a batch in one transaction; when this returns, it is on the disk.

        The first good value of a channel and time wins. A good one replaces a bad or uncertain one
        of the same time; anything else that is sent again is a duplicate. What is older than the
        raw samples that are kept (`kept_from_us`) is not stored and in neither count. A value that
        is not a finite number is stored as none, and then its quality cannot be good.
        ``patience_s``: wall seconds to wait for other writers. Raises `ValueError` if a time is
        outside 0 to 2**63 - 1 microseconds or a quality outside 0 to 255. Raises
        `StoreUnavailableError` if the store cannot take them now; nothing of the batch is stored
        then.
        """
        if not samples:
            return WriteCounts(0, 0)
        assets, channels, times_us, values, qualities, received_us = zip(*samples, strict=True)
        first_us = min(times_us)
        moments_us = set(received_us)  # few: what is read or sent at once is received at once
        if not (
            first_us >= 0
            and max(times_us) < _LONG
            and min(moments_us) >= 0
            and max(moments_us) < _LONG
            and set(qualities) <= _BYTES
        ):
            _refuse(samples)
        cleaned = _cleaned(values, qualities)
        names = list(zip(assets, channels, strict=True))
        columns = SampleColumns((), times_us, *cleaned, received_us)
        try:
            return self._write(self._database.writing_samples(patience_s), names, columns)
        except AloneNeededError:  # a new channel, or a month that begins
            return self._write(self._database.writing(patience_s), names, columns)

    def _write(
        self,
        turn: AbstractContextManager[Connection],
        names: Sequence[tuple[str, str]],
        columns: SampleColumns,
    ) -> WriteCounts:
        dialect = self._database.dialect
        with turn as connection:
            # Of the store that this connection leads to: the next one may lead to another.
            ids: dict[tuple[str, str], int] = connection.info.setdefault(_CHANNEL_IDS, {})
            made: dict[tuple[str, str], int] = {}
            try:
                numbers = [ids[name] for name in names]
            except KeyError:
                made = _numbers(connection, set(names) - ids.keys())
                numbers = [ids[name] if name in ids else made[name] for name in names]
            columns = columns._replace(channel_ids=numbers)
            horizon_us = self._kept_from_us = raw_horizon_us(connection)
            if min(columns.times_us) < horizon_us:
                columns = chosen(columns, [time_us >= horizon_us for time_us in columns.times_us])
            stored = 0
            try:
                if columns.times_us:
                    hours = _hours(columns)
                    locked = dialect.lock_hours(connection, hours)
                    left, stored, changed = merge_late(connection, columns)
                    if left.times_us:
                        stored += dialect.upsert_samples(connection, left)
                    needed = hours if left is columns else _hours(left) | changed
                    dialect.mark_stale(connection, needed, locked)
            except IntegrityError as error:
                # What is remembered of the store is not true; the samples are, and wait.
                connection.info.clear()
                raise StoreUnavailableError(
                    f"{self._database.name}: its tables do not fit together "
                    f"({' '.join(str(error.orig).split())})"
                ) from error
        # Only now: had the transaction failed, the channels would not be there.
        ids |= made
        return WriteCounts(stored, len(columns.times_us) - stored)

    def keep_from(self, time_us: int) -> None:
        """Record that raw samples before a time are not kept any more."""
        self._kept_from_us = time_us

    def channels(self, asset: str) -> list[str]:
        """Names of the channels of an asset that were ever stored, sorted."""
        with self._database.reading() as connection:
            return sorted(channel_ids(connection, asset))

    def read(
        self,
        asset: str,
        channels: Sequence[str] | None,
        start_us: int,
        end_us: int,
        limit: int,
        after: tuple[int, str] | None = None,
    ) -> list[StoredSample]:
        """Raw samples, ascending by time, then by channel name.

        - ``start_us``, ``end_us``: UTC microseconds; the start is included, the end is not.
        - ``after``: time and channel of the last sample of the page before: go on behind it.
        """
        with self._database.reading() as connection:
            ids = channel_ids(connection, asset, channels)

            def read(name: str, from_us: int, count: int) -> list[StoredSample]:
                query = (
                    select(
                        SampleRow.time_us,
                        SampleRow.value,
                        SampleRow.quality,
                        SampleRow.received_us,
                    )
                    .where(
                        SampleRow.channel_id == ids[name],
                        SampleRow.time_us >= from_us,
                        SampleRow.time_us < end_us,
                    )
                    .order_by(SampleRow.time_us)
                    .limit(count)
                )
                rows: list[packed.Row] = [
                    (time_us, value, quality, received_us)
                    for time_us, value, quality, received_us in connection.execute(query)
                ]
                until_us = rows[-1][0] if len(rows) == count else end_us
                from_blocks: list[packed.Row] = []
                for samples in packed.read(connection, ids[name], from_us, until_us):
                    from_blocks += packed.rows(samples)
                    if len(from_blocks) >= count:
                        break
                if from_blocks:
                    rows = sorted(rows + from_blocks, key=itemgetter(0))[:count]
                return [StoredSample(name, *row) for row in rows]

            def first_us(name: str) -> int:
                return start_us if after is None else max(start_us, after[0] + (name <= after[1]))

            # Ordered walks along the primary key: the work is bounded by the limit however long
            # the span is.
            return merged(ids, read, lambda row: row.time_us + 1, first_us, limit)

    def span(
        self,
        asset: str,
        channels: Sequence[str] | None,
        start_us: int,
        end_us: int,
        count_max: int,
    ) -> tuple[int, int, int] | None:
        """Where in a span the samples lie, and how many the fullest channel has.

        ``start_us``, ``end_us``: UTC microseconds; the start is included, the end is not. Returns
        time of the first and of the last sample, and the count; None without any sample.
        """
        firsts, lasts, counts = [], [], []
        with self._database.reading() as connection:
            for channel_id in channel_ids(connection, asset, channels).values():
                inside = (
                    SampleRow.channel_id == channel_id,
                    SampleRow.time_us >= start_us,
                    SampleRow.time_us < end_us,
                )
                some = select(SampleRow.time_us).where(*inside)
                first = connection.scalar(some.order_by(SampleRow.time_us).limit(1))
                last = connection.scalar(some.order_by(SampleRow.time_us.desc()).limit(1))
                counted = select(func.count()).select_from(some.limit(count_max).subquery())
                spans = [packed.span(connection, channel_id, start_us, end_us)]
                if first is not None and last is not None:
                    spans.append((first, last, connection.scalar(counted) or 0))
                found = [span for span in spans if span is not None]
                firsts += [span[0] for span in found]
                lasts += [span[1] for span in found]
                counts.append(min(sum(span[2] for span in found), count_max))
        return (min(firsts), max(lasts), max(counts)) if firsts else None

    def raw_kept_from_us(self) -> int:
        """Time from which on raw samples are kept, UTC microseconds; 0 when all are."""
        with self._database.reading() as connection:
            self._kept_from_us = raw_horizon_us(connection)
            return self._kept_from_us

    @property
    def kept_from_us(self) -> int:
        """As `raw_kept_from_us`, from memory: as it was when the store was last asked."""
        if self._kept_from_us is None:
            try:
                return self.raw_kept_from_us()
            except StoreUnavailableError:
                return 0
        return self._kept_from_us

    def latest(self, asset: str) -> dict[str, StoredSample]:
        """Give the newest sample of each channel of an asset, whatever its quality."""
        newest = {}
        with self._database.reading() as connection:
            for name, channel_id in channel_ids(connection, asset).items():
                if row := _newest(connection, channel_id):
                    newest[name] = StoredSample(name, *row)
        return newest

    def counts(self, count_max: int) -> dict[tuple[str, str], int]:
        """Count the samples of every asset and channel that was ever stored, up to a number."""
        counts = {}
        with self._database.reading() as connection:
            channels = connection.execute(select(ChannelRow.asset, ChannelRow.name, ChannelRow.id))
            for asset, name, channel_id in channels.all():
                some = select(SampleRow.time_us).where(SampleRow.channel_id == channel_id)
                count = select(func.count()).select_from(some.limit(count_max).subquery())
                total = (connection.scalar(count) or 0) + packed.count(connection, channel_id)
                counts[asset, name] = min(total, count_max)
        return counts

    def open_ends(
        self, assets: Collection[str] | None = None, before_us: int = _LATER_US
    ) -> dict[tuple[str, str], int]:
        """Find the channels, of some assets or all, whose newest sample is not bad, and its time.

        At the start of a service these are the channels that were recorded when the last run
        ended. Samples from `before_us` on are not looked at.
        """
        ends = {}
        with self._database.reading() as connection:
            query = select(ChannelRow.asset, ChannelRow.name, ChannelRow.id)
            if assets is None:
                channels: Sequence[Row[*tuple[Any, ...]]] = connection.execute(query).all()
            else:
                channels = rows_of(connection, ChannelRow.asset, query, assets)
            for asset, name, channel_id in channels:
                newest = _newest(connection, channel_id, before_us)
                if newest is not None and not is_bad(newest[2]):
                    ends[asset, name] = newest[0]
        return ends

    def with_history(self, assets: Collection[str] | None = None) -> set[str]:
        """Those of some assets, or of all, of which any sample was ever stored."""
        with self._database.reading() as connection:
            key = ChannelRow.asset
            if assets is None:
                return set(connection.scalars(select(key).distinct()))
            return {row[0] for row in rows_of(connection, key, select(key).distinct(), assets)}

    def first_time_us(self, asset: str) -> int | None:
        """Time of the oldest sample of an asset, UTC microseconds; None when there is none."""
        with self._database.reading() as connection:
            ids = channel_ids(connection, asset)
            firsts = [first_time_us(connection, channel_id, 0) for channel_id in ids.values()]
        return min((first for first in firsts if first is not None), default=None)


def channel_ids(
    connection: Connection, asset: str, channels: Sequence[str] | None = None
) -> dict[str, int]:
    """Numbers of the channels of an asset by name; of those asked for, the ones there are."""
    query = select(ChannelRow.name, ChannelRow.id).where(ChannelRow.asset == asset)
    if channels is not None:
        query = query.where(ChannelRow.name.in_(channels))
    return dict(connection.execute(query.order_by(ChannelRow.name)).all())


def raw_horizon_us(connection: Connection) -> int:
    """Time before which raw samples are not kept any more, UTC microseconds."""
    return connection.scalar(select(RawHorizonRow.time_us)) or 0


def first_time_us(connection: Connection, channel_id: int, start_us: int) -> int | None:
    """Time of the first sample of a channel at or after a time."""
    query = (
        select(SampleRow.time_us)
        .where(SampleRow.channel_id == channel_id, SampleRow.time_us >= start_us)
        .order_by(SampleRow.time_us)
        .limit(1)
    )
    firsts = (connection.scalar(query), packed.first_time_us(connection, channel_id, start_us))
    return min((first for first in firsts if first is not None), default=None)


def last_time_us(connection: Connection, channel_id: int) -> int | None:
    """Time of the newest sample of a channel."""
    newest = _newest(connection, channel_id)
    return None if newest is None else newest[0]


def _newest(
    connection: Connection, channel_id: int, before_us: int = _LATER_US
) -> packed.Row | None:
    query = (
        select(SampleRow.time_us, SampleRow.value, SampleRow.quality, SampleRow.received_us)
        .where(SampleRow.channel_id == channel_id, SampleRow.time_us < before_us)
        .order_by(SampleRow.time_us.desc())
        .limit(1)
    )
    newest = None
    for time_us, value, quality, received_us in connection.execute(query):
        newest = (time_us, value, quality, received_us)
    # A damaged page may give a row without a time.
    after_us = newest[0] if newest and newest[0] else -1
    return packed.newest(connection, channel_id, after_us, before_us) or newest


def _numbers(connection: Connection, names: set[tuple[str, str]]) -> dict[tuple[str, str], int]:
    """Numbers of channels; those that have none yet get one."""
    assets = {asset for asset, _ in names}
    query = select(ChannelRow.asset, ChannelRow.name, ChannelRow.id)
    rows = rows_of(connection, ChannelRow.asset, query, assets)
    numbers = {(asset, name): number for asset, name, number in rows if (asset, name) in names}
    # No one else writes meanwhile: the connection holds the right to.
    missing = sorted(names - numbers.keys())
    if missing:
        require_alone(connection)
    for asset, name in missing:
        numbers[asset, name] = connection.execute(
            insert(ChannelRow).values(asset=asset, name=name).returning(ChannelRow.id)
        ).scalar_one()
    return numbers


def _cleaned(
    values: Sequence[float], qualities: Sequence[int]
) -> tuple[Sequence[float | None], Sequence[int]]:
    """Values and qualities as they are stored: no value that is not a finite number."""
    # Plain integers: a database driver takes its time over other kinds.
    numbers = list(bytes(qualities))
    isfinite = math.isfinite
    if all(map(isfinite, values)):
        return values, numbers
    pairs = zip(values, numbers, strict=True)
    return [value if isfinite(value) else None for value in values], [
        int(Quality.BAD) if is_good(quality) and not isfinite(value) else quality
        for value, quality in pairs
    ]


def _hours(columns: SampleColumns) -> set[tuple[int, int]]:
    """Channels and hours of these samples."""
    times_us = columns.times_us
    if times_us and min(times_us) // HOUR_US == max(times_us) // HOUR_US:  # as nearly always
        hour_us = times_us[0] // HOUR_US * HOUR_US
        return {(channel_id, hour_us) for channel_id in set(columns.channel_ids)}
    return {
        (channel_id, time_us // HOUR_US * HOUR_US)
        for channel_id, time_us in zip(columns.channel_ids, times_us, strict=True)
    }


def _refuse(samples: Iterable[Sample]) -> NoReturn:
    wrong = next(
        one
        for one in samples
        if not (
            0 <= one.time_us < _LONG and 0 <= one.received_us < _LONG and 0 <= one.quality <= 255
        )
    )
    raise ValueError(f"sample {wrong}: expected times after 1970 and a quality byte")
