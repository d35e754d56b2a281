"""Samples of an hour of many channels: read at once, and in portions that take little time."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, Select, delete, select

from service.clock import HOUR_US
from service.store import packed
from service.store.blocks import ChannelSamples
from service.store.database import Database
from service.store.tables import ChannelRow, SampleRow

#: Samples of one transaction and of one block: other writers have their turn in between, and a
#: reader of one channel does not unpack all of a large machine.
_SAMPLES_MAX = 100_000
#: Wall seconds for which one transaction keeps its turn.
_TURN_S = 0.1
_FIRST_PORTION, _PORTION_MAX = 64, 1000


class HourOfChannels(NamedTuple):
    """Samples of channels, ascending by channel, then by time; both columns are as long."""

    channel_ids: NDArray[np.int64]
    samples: ChannelSamples

    def by_channel(self) -> Iterator[tuple[int, ChannelSamples]]:
        """Give the channels that have samples one by one."""
        ids = self.channel_ids
        if not ids.size:
            return
        ends = [*(np.flatnonzero(np.diff(ids)) + 1).tolist(), ids.size]
        begin = 0
        for end in ends:
            yield int(ids[begin]), self.samples.taken(slice(begin, end))
            begin = end


class Portions:
    """How many channels a transaction takes: as many as are done within a tenth of a second."""

    def __init__(self) -> None:
        self.size = _FIRST_PORTION

    @contextmanager
    def measured(self, count: int) -> Iterator[None]:
        """Learn from the work on this many channels, which holds the turn."""
        begun_s = time.monotonic()
        yield
        taken_s = max(time.monotonic() - begun_s, 1e-6)
        fitting = math.floor(count * min(_TURN_S / taken_s, 2.0))
        # A few channels that took little time do not say that many would.
        if 2 * count > self.size or fitting < self.size:
            self.size = min(max(fitting, 1), _PORTION_MAX)


def read(
    connection: Connection, database: Database, channel_ids: Sequence[int], hour_us: int
) -> tuple[list[int], HourOfChannels]:
    """Read the samples of an hour of channels, those in the table and those in blocks.

    Returns the first of the channels, as many as fit into one transaction and at least one, and
    their samples. ``channel_ids``: ascending.
    """
    taken, found = read_table(connection, database, channel_ids, hour_us)
    hours = packed.hours_within(connection, taken, hour_us)
    if not hours:
        return taken, found
    parts = [found]
    for hour in hours:
        samples = packed.samples_of(connection, hour)
        parts.append(HourOfChannels(np.full(samples.times_us.size, hour.channel_id), samples))
    ids = np.concatenate([part.channel_ids for part in parts])
    columns = [
        np.concatenate(column) for column in zip(*(part.samples for part in parts), strict=True)
    ]
    order = np.lexsort((columns[0], ids))
    return taken, HourOfChannels(ids[order], ChannelSamples(*(column[order] for column in columns)))


def read_table(
    connection: Connection, database: Database, channel_ids: Sequence[int], hour_us: int
) -> tuple[list[int], HourOfChannels]:
    """As `read`, of those in the table."""
    if not channel_ids:
        return [], HourOfChannels(np.empty(0, np.int64), packed.NOTHING)
    end_us = hour_us + HOUR_US
    read_samples = database.dialect.read_samples
    found = HourOfChannels(
        *read_samples(connection, channel_ids, hour_us, end_us, _SAMPLES_MAX + 1)
    )
    if found.channel_ids.size <= _SAMPLES_MAX:
        return list(channel_ids), found
    last = int(found.channel_ids[-1])
    if last == found.channel_ids[0]:
        # A channel that is faster than that has a transaction and a block of its own.
        alone = [channel_id for channel_id in channel_ids if channel_id <= last]
        return alone, HourOfChannels(
            *read_samples(connection, [last], hour_us, end_us, np.iinfo(np.int64).max)
        )
    whole = slice(0, int(np.searchsorted(found.channel_ids, last)))
    return (
        [channel_id for channel_id in channel_ids if channel_id < last],
        HourOfChannels(found.channel_ids[whole], found.samples.taken(whole)),
    )


def remove_from_table(connection: Connection, channel_ids: Sequence[int], hour_us: int) -> int:
    """Remove the samples of an hour of channels from the table; how many there were."""
    return connection.execute(
        delete(SampleRow).where(
            SampleRow.channel_id.in_(channel_ids),
            SampleRow.time_us >= hour_us,
            SampleRow.time_us < hour_us + HOUR_US,
        )
    ).rowcount


def owned_channels(connection: Connection, owns: Callable[[str], bool]) -> set[int]:
    """Numbers of the channels of some assets."""
    rows = connection.execute(select(ChannelRow.asset, ChannelRow.id).order_by(ChannelRow.asset))
    found: set[int] = set()
    for asset, channels in groupby(rows, itemgetter(0)):
        if owns(asset):
            found.update(channel_id for _, channel_id in channels)
    return found


def oldest_in_table() -> Select[str, int, int | None]:
    """Select asset, number and the time of the oldest sample in the table of each channel."""
    return _ends(SampleRow.time_us.expression)


def newest_in_table() -> Select[str, int, int | None]:
    """As `oldest_in_table`, of the newest."""
    return _ends(SampleRow.time_us.desc())


def _ends(order: ColumnElement[int]) -> Select[str, int, int | None]:
    # One look per channel at the primary key; a plain minimum would read all samples.
    end = select(SampleRow.time_us).where(SampleRow.channel_id == ChannelRow.id)
    time_us = end.order_by(order).limit(1).scalar_subquery()
    return select(ChannelRow.asset, ChannelRow.id, time_us.label("time_us"))
