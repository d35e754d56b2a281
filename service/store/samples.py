"""Raw samples: written in batches, each time of a channel once, read in order."""

import math
from collections.abc import Collection, Iterable, Sequence
from operator import itemgetter
from typing import Any, NoReturn

from sqlalchemy import Connection, Row, func, insert, select

from adapters.samples import Quality, Sample, is_bad, is_good
from service.clock import HOUR_US
from service.store import packed
from service.store.database import PATIENCE_S, Database, SampleColumns, chosen
from service.store.errors import StoreUnavailableError
from service.store.merging import merged
from service.store.packing import make_room
from service.store.part import StorePart, rows_of
from service.store.records import StoredSample, WriteCounts
from service.store.tables import ChannelRow, RawHorizonRow, SampleRow

_LONG = 2**63
_BYTES = frozenset(range(256))


class Samples(StorePart):
    """Raw samples of all channels of all assets."""

    def __init__(self, database: Database) -> None:
        super().__init__(database)
        self._ids: dict[tuple[str, str], int] = {}
        self._kept_from_us: int | None = None

    def write(self, samples: Collection[Sample], patience_s: float = PATIENCE_S) -> WriteCounts:
        """Store a batch in one transaction; when this returns, it is on the disk.

        The first good value of a channel and time wins. A good one replaces a bad or uncertain
        one of the same time; anything else that is sent again is a duplicate. What is older than
        the raw samples that are kept (`kept_from_us`) is not stored and in neither count. A value
        that is not a finite number is stored as none, and then its quality cannot be good.

        Parameters
        ----------
        samples : collection of Sample
            In any order, of any assets.
        patience_s : float
            Wall seconds to wait for other writers.

        Raises
        ------
        ValueError
            If a time is outside 0 to 2**63 - 1 microseconds or a quality outside 0 to 255.
        StoreUnavailableError
            If the store cannot take them now; nothing of the batch is stored then.
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
        with self._database.writing(patience_s) as connection:
            ids = self._ids
            try:
                numbers = [ids[name] for name in zip(assets, channels, strict=True)]
            except KeyError:
                missing = set(zip(assets, channels, strict=True)) - ids.keys()
                ids = ids | {name: _make_channel(connection, *name) for name in missing}
                numbers = [ids[name] for name in zip(assets, channels, strict=True)]
            columns = SampleColumns(numbers, times_us, *cleaned, received_us)
            horizon_us = self._kept_from_us = raw_horizon_us(connection)
            if first_us < horizon_us:
                columns = chosen(columns, [time_us >= horizon_us for time_us in columns.times_us])
            stored, known = 0, 0
            if columns.times_us:
                columns, known = make_room(connection, self._database, columns)
            if columns.times_us:
                stored = self._database.dialect.upsert_samples(connection, columns)
            if columns.times_us:
                self._database.dialect.mark_stale(connection, _hours(columns))
        # Only now: had the transaction failed, the channels would not be there.
        self._ids = ids
        return WriteCounts(stored, len(columns.times_us) - stored + known)

    def keep_from(self, time_us: int) -> None:
        """Take note that raw samples before a time are not kept any more."""
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

        Parameters
        ----------
        asset : str
            Asset to read.
        channels : sequence of str or None
            Which channels; None for all. Unknown ones have no samples.
        start_us, end_us : int
            UTC microseconds; the start is included, the end is not.
        limit : int
            Samples at most.
        after : tuple of int and str, optional
            Time and channel of the last sample of the page before: go on behind it.
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

        Parameters
        ----------
        asset : str
            Asset to look at.
        channels : sequence of str or None
            Which channels; None for all.
        start_us, end_us : int
            UTC microseconds; the start is included, the end is not.
        count_max : int
            Count no further than this.

        Returns
        -------
        tuple of int or None
            Time of the first and of the last sample, and the count; None without any sample.
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

    def open_ends(self, assets: Collection[str] | None = None) -> dict[tuple[str, str], int]:
        """Find the channels, of some assets or all, whose newest sample is not bad, and its time.

        At the start of a service these are the channels that were recorded when the last run
        ended.
        """
        ends = {}
        with self._database.reading() as connection:
            query = select(ChannelRow.asset, ChannelRow.name, ChannelRow.id)
            if assets is None:
                channels: Sequence[Row[*tuple[Any, ...]]] = connection.execute(query).all()
            else:
                channels = rows_of(connection, ChannelRow.asset, query, assets)
            for asset, name, channel_id in channels:
                newest = _newest(connection, channel_id)
                if newest is not None and not is_bad(newest[2]):
                    ends[asset, name] = newest[0]
        return ends

    def with_history(self, assets: Collection[str]) -> set[str]:
        """Those of some assets of which any sample was ever stored."""
        with self._database.reading() as connection:
            key = ChannelRow.asset
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


def _newest(connection: Connection, channel_id: int) -> packed.Row | None:
    query = (
        select(SampleRow.time_us, SampleRow.value, SampleRow.quality, SampleRow.received_us)
        .where(SampleRow.channel_id == channel_id)
        .order_by(SampleRow.time_us.desc())
        .limit(1)
    )
    newest = None
    for time_us, value, quality, received_us in connection.execute(query):
        newest = (time_us, value, quality, received_us)
    # A damaged page may give a row without a time.
    after_us = newest[0] if newest and newest[0] else -1
    return packed.newest(connection, channel_id, after_us) or newest


def _make_channel(connection: Connection, asset: str, name: str) -> int:
    query = select(ChannelRow.id).where(ChannelRow.asset == asset, ChannelRow.name == name)
    known = connection.scalar(query)
    if known is not None:
        return known
    # No one else writes meanwhile: the connection holds the right to.
    return connection.execute(
        insert(ChannelRow).values(asset=asset, name=name).returning(ChannelRow.id)
    ).scalar_one()


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
