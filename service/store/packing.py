"""Moves samples of hours that are over into blocks, and adds to them what comes later."""

import math
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, select

from adapters.samples import Quality
from service.clock import HOUR_US
from service.store import hours, packed
from service.store.blocks import Block, ChannelSamples, is_damaged
from service.store.database import Database, SampleColumns, chosen
from service.store.errors import StoreUnavailableError
from service.store.hours import Portions, oldest_in_table, owned_channels
from service.store.part import StorePart, rows_of
from service.store.tables import (
    ChannelRow,
    PackedHourRow,
    SampleBlockRow,
    StaleRollupRow,
)

#: Blocks that are looked through at a time.
_PORTION = 100


class Packing(StorePart):
    """Keeps hours that are over in blocks; what is read and written is the same as before."""

    def __init__(self, database: Database) -> None:
        super().__init__(database)
        self._portions = Portions()

    def pack(
        self,
        before_us: int,
        until_s: float = math.inf,
        owns: Callable[[str], bool] | None = None,
    ) -> int:
        """Pack the oldest hour of each channel whose samples are in the table, if it is over.

        Hours whose rollups are not computed yet wait for that. Each transaction is short; it is as
        well to stop in between. Returns how many were packed; call again until it is 0.

        - ``before_us``: only hours that ended by this time, UTC microseconds.
        - ``until_s``: when to stop, on the monotonic clock.
        - ``owns``: whether an asset is to be looked at; None: all are.
        """
        end_us = before_us - before_us % HOUR_US
        with self._database.reading() as connection:
            due = _due(connection, end_us, owns)
        done = 0
        for hour_us, assets in due:
            left = list(assets.items())
            while left and time.monotonic() < until_s:
                portion = dict(_first_of(left, self._portions.size))
                with self._database.writing_samples() as connection:
                    taken, count = self._pack_portion(connection, portion, hour_us)
                left = [(number, asset) for number, asset in left if number not in taken]
                done += count
        return done

    def _pack_portion(
        self, connection: Connection, assets: Mapping[int, str], hour_us: int
    ) -> tuple[set[int], int]:
        """Pack an hour of the first of some channels: which ones were looked at, how many done.

        Channels of an asset that were read at the same times come into one block.
        """
        database = self._database
        with self._portions.measured(len(assets)):
            channel_ids = sorted(assets)
            keys = [(channel_id, hour_us) for channel_id in channel_ids]
            locked = database.dialect.lock_hours(connection, keys)
            stale = set(
                connection.scalars(
                    select(StaleRollupRow.channel_id).where(
                        StaleRollupRow.channel_id.in_(channel_ids),
                        StaleRollupRow.hour_us == hour_us,
                    )
                )
            ).difference(channel_id for channel_id, _ in locked)
            current = [channel_id for channel_id in channel_ids if channel_id not in stale]
            taken, found = hours.read_table(connection, database, current, hour_us)
            groups: dict[tuple[str, bytes], list[tuple[int, ChannelSamples]]] = defaultdict(list)
            for channel_id, samples in found.by_channel():
                key = assets[channel_id], samples.times_us.tobytes()
                groups[key].append((channel_id, samples))
            with_samples = [channel_id for group in groups.values() for channel_id, _ in group]
            # One whose block is damaged, or that another version has left there.
            for hour in packed.hours_within(connection, with_samples, hour_us):
                packed.remove(connection, hour.channel_id, hour_us)
            packed.add(connection, hour_us, groups.values())
            removed = hours.remove_from_table(connection, taken, hour_us)
            if removed != found.channel_ids.size:  # no one else may write there meanwhile
                raise StoreUnavailableError(
                    f"{database.name}: {removed} samples of an hour, expected "
                    f"{found.channel_ids.size}; it is packed later"
                )
            database.dialect.mark_stale(connection, (), locked)
        return stale.union(taken), len(with_samples)

    def find_damage(self) -> str | None:
        """Look through all blocks; one line that says which samples are lost, or None."""
        broken: list[int] = []
        after = 0
        query = select(
            SampleBlockRow.id, SampleBlockRow.codec, SampleBlockRow.crc, SampleBlockRow.data
        ).order_by(SampleBlockRow.id)
        while True:
            with self._database.reading() as connection:
                rows = connection.execute(
                    query.where(SampleBlockRow.id > after).limit(_PORTION)
                ).all()
            if not rows:
                break
            broken += [row[0] for row in rows if is_damaged(Block(*row[1:]))]
            after = rows[-1][0]
        of_asset = select(ChannelRow.asset, PackedHourRow.sample_count).join(
            PackedHourRow, PackedHourRow.channel_id == ChannelRow.id
        )
        with self._database.reading() as connection:
            missing = PackedHourRow.block_id.not_in(select(SampleBlockRow.id))
            lost = list(connection.execute(of_asset.where(missing)).all())
            for first in range(0, len(broken), _PORTION):
                of_block = PackedHourRow.block_id.in_(broken[first : first + _PORTION])
                lost += connection.execute(of_asset.where(of_block)).all()
        if not lost:
            return None
        assets = ", ".join(sorted({asset for asset, _ in lost}))
        return (
            f"blocks of samples are damaged: {sum(count for _, count in lost)} samples of "
            f"{assets} cannot be read; restore a backup if they are needed"
        )


class Merged(NamedTuple):
    """What became of samples of packed hours.

    - ``left``: those that are still to be written: their hours are not packed.
    - ``stored``: how many were stored.
    - ``changed``: channels and hours in which some were.
    """

    left: SampleColumns
    stored: int
    changed: set[tuple[int, int]]


def merge_late(connection: Connection, columns: SampleColumns) -> Merged:
    """Put samples of packed hours into blocks: only those of their channels and hours change."""
    begin_us = min(columns.times_us) // HOUR_US * HOUR_US
    late = select(PackedHourRow.hour_us).where(
        PackedHourRow.hour_us >= begin_us, PackedHourRow.hour_us <= max(columns.times_us)
    )
    if connection.scalar(late.limit(1)) is None:  # as nearly always
        return Merged(columns, 0, set())
    here: dict[tuple[int, int], list[int]] = defaultdict(list)
    for number, (channel_id, time_us) in enumerate(
        zip(columns.channel_ids, columns.times_us, strict=True)
    ):
        here[channel_id, time_us - time_us % HOUR_US].append(number)
    left = np.ones(len(columns.times_us), bool)
    stored = 0
    changed: dict[int, dict[tuple[int, bytes], list[tuple[int, ChannelSamples]]]] = {}
    for hour in packed.hours_of(connection, here):
        numbers = here[hour.channel_id, hour.hour_us]
        left[numbers] = False
        samples, count = _joined(packed.samples_of(connection, hour), columns, numbers)
        if count:
            stored += count
            # Those that were in one block and have the same times still are in one again.
            key = hour.block_id, samples.times_us.tobytes()
            groups = changed.setdefault(hour.hour_us, {})
            groups.setdefault(key, []).append((hour.channel_id, samples))
    for hour_us, groups in changed.items():
        for channel_id, _ in chain.from_iterable(groups.values()):
            packed.remove(connection, channel_id, hour_us)
        packed.add(connection, hour_us, groups.values())
    return Merged(
        columns if left.all() else chosen(columns, left.tolist()),
        stored,
        {
            (channel_id, hour_us)
            for hour_us, groups in changed.items()
            for channel_id, _ in chain.from_iterable(groups.values())
        },
    )


def _joined(
    stored: ChannelSamples, columns: SampleColumns, numbers: Sequence[int]
) -> tuple[ChannelSamples, int]:
    """Add samples in the order in which they came, by the rule of `Samples.write`; how many."""
    times_us = np.array([columns.times_us[number] for number in numbers], np.int64)
    qualities = np.array([columns.qualities[number] for number in numbers], np.int64)
    added: dict[int, int] = {}
    count = 0
    for place in np.flatnonzero(~_changes_nothing(stored, times_us, qualities)).tolist():
        number = numbers[place]
        time_us, quality = columns.times_us[number], columns.qualities[number]
        before = added.get(time_us)
        if before is None or columns.qualities[before] < Quality.GOOD <= quality:
            added[time_us] = number
            count += 1
    if not count:
        return stored, 0
    new = ChannelSamples(
        np.array(list(added), np.int64),
        np.array([columns.values[number] for number in added.values()], np.float64),
        np.array([columns.qualities[number] for number in added.values()], np.uint16),
        np.array([columns.received_us[number] for number in added.values()], np.int64),
    )
    kept = ~np.isin(stored.times_us, new.times_us)
    parts = (stored.times_us[kept], new.times_us)
    order = np.argsort(np.concatenate(parts))
    joined = ChannelSamples(
        np.concatenate(parts)[order],
        np.concatenate((stored.values[kept], new.values))[order],
        np.concatenate((stored.qualities[kept], new.qualities))[order],
        np.concatenate((stored.received_us[kept], new.received_us))[order],
    )
    return joined, count


def _changes_nothing(
    stored: ChannelSamples, times_us: NDArray[np.int64], qualities: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Find which samples are stored, and do not mend what is: see `Samples.write`."""
    if not stored.times_us.size:
        return np.zeros(times_us.size, bool)
    at = np.minimum(np.searchsorted(stored.times_us, times_us), stored.times_us.size - 1)
    mends = (stored.qualities[at] < Quality.GOOD) & (qualities >= Quality.GOOD)
    known: NDArray[np.bool_] = (stored.times_us[at] == times_us) & ~mends
    return known


def _due(
    connection: Connection, end_us: int, owns: Callable[[str], bool] | None
) -> list[tuple[int, dict[int, str]]]:
    """Find the oldest hour in the table of samples of each channel: hours with their channels.

    The channels of an asset follow each other.
    """
    found: dict[int, dict[int, str]] = defaultdict(dict)
    query = oldest_in_table()
    if owns is None:
        rows = connection.execute(query).all()
    else:
        rows = rows_of(connection, ChannelRow.id, query, owned_channels(connection, owns))
    for asset, channel_id, time_us in sorted(rows, key=itemgetter(0, 1)):
        if time_us is not None and time_us - time_us % HOUR_US < end_us:
            found[time_us - time_us % HOUR_US][channel_id] = asset
    return sorted(found.items())


def _first_of(channels: Sequence[tuple[int, str]], count: int) -> Sequence[tuple[int, str]]:
    """Give the first channels, about so many, so that none of an asset is left if it fits."""
    if count < len(channels):
        whole = count
        while whole and channels[whole][1] == channels[whole - 1][1]:
            whole -= 1
        count = whole or count
    return channels[:count]
