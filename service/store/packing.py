"""Moves samples of hours that are over into blocks, and back when an hour gets another sample."""

import math
import time
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, delete, insert, select

from adapters.samples import Quality
from service.clock import HOUR_US
from service.store import packed
from service.store.blocks import UNKNOWN_US, Block, Samples, is_damaged, pack
from service.store.database import Database, SampleColumns, chosen
from service.store.packed import PackedHour
from service.store.part import StorePart
from service.store.tables import (
    ChannelRow,
    PackedHourRow,
    SampleBlockRow,
    SampleRow,
    StaleRollupRow,
)

#: Samples of one transaction and of one block: other writers have their turn in between, and a
#: reader of one channel does not unpack all of a large machine.
_MOST = 100_000
#: Blocks that are looked through at a time.
_PORTION = 100


class Packing(StorePart):
    """Keeps hours that are over in blocks; what is read and written is the same as before."""

    def pack(self, before_us: int, until_s: float = math.inf) -> int:
        """Pack the oldest hour of each channel whose samples are in the table, if it is over.

        Hours whose rollups are not computed yet wait for that. Each transaction is short; it is
        as well to stop in between.

        Parameters
        ----------
        before_us : int
            Only hours that ended by this time, UTC microseconds.
        until_s : float
            When to stop, on the monotonic clock.

        Returns
        -------
        int
            Hours of channels that were packed; call again until it is 0.
        """
        end_us = before_us - before_us % HOUR_US
        with self._database.reading() as connection:
            due = _due(connection, end_us)
        done = 0
        for hour_us, channel_ids in due:
            left = list(channel_ids)
            while left and time.monotonic() < until_s:
                with self._database.writing() as connection:
                    taken, count = _pack_hour(connection, left, hour_us)
                left = left[taken:]
                done += count
        return done

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
        hours = select(ChannelRow.asset, PackedHourRow.sample_count).join(
            PackedHourRow, PackedHourRow.channel_id == ChannelRow.id
        )
        with self._database.reading() as connection:
            missing = PackedHourRow.block_id.not_in(select(SampleBlockRow.id))
            lost = list(connection.execute(hours.where(missing)).all())
            for first in range(0, len(broken), _PORTION):
                of_block = PackedHourRow.block_id.in_(broken[first : first + _PORTION])
                lost += connection.execute(hours.where(of_block)).all()
        if not lost:
            return None
        assets = ", ".join(sorted({asset for asset, _ in lost}))
        return (
            f"blocks of samples are damaged: {sum(count for _, count in lost)} samples of "
            f"{assets} cannot be read; restore a backup if they are needed"
        )


def make_room(
    connection: Connection, database: Database, columns: SampleColumns
) -> tuple[SampleColumns, int]:
    """Bring the hours for which there are new samples back into the table of samples.

    Parameters
    ----------
    connection : sqlalchemy.Connection
        Holds the right to write.
    database : Database
        The store's.
    columns : SampleColumns
        What is going to be written.

    Returns
    -------
    tuple of SampleColumns and int
        What is still to be written, and how many others change nothing: they are stored already.
    """
    begin_us = min(columns.times_us) // HOUR_US * HOUR_US
    late = select(PackedHourRow.hour_us).where(
        PackedHourRow.hour_us >= begin_us, PackedHourRow.hour_us <= max(columns.times_us)
    )
    if connection.scalar(late.limit(1)) is None:  # as nearly always
        return columns, 0
    here: dict[tuple[int, int], list[int]] = defaultdict(list)
    for number, (channel_id, time_us) in enumerate(
        zip(columns.channel_ids, columns.times_us, strict=True)
    ):
        here[channel_id, time_us - time_us % HOUR_US].append(number)
    known = np.zeros(len(columns.times_us), bool)
    for hour in packed.hours_of(connection, here):
        numbers = here[hour.channel_id, hour.hour_us]
        samples = packed.samples_of(connection, hour)
        is_known = _changes_nothing(
            samples,
            np.array([columns.times_us[number] for number in numbers], np.int64),
            np.array([columns.qualities[number] for number in numbers], np.int64),
        )
        if is_known.all():
            known[numbers] = True
        else:
            _bring_back(connection, database, hour, samples)
    if not known.any():
        return columns, 0
    kept = (~known).tolist()
    return chosen(columns, kept), int(known.sum())


def _changes_nothing(
    stored: Samples, times_us: NDArray[np.int64], qualities: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Tell which samples are stored, and do not mend what is: see `Samples.write`."""
    if not stored.times_us.size:
        return np.zeros(times_us.size, bool)
    at = np.minimum(np.searchsorted(stored.times_us, times_us), stored.times_us.size - 1)
    mends = (stored.qualities[at] < Quality.GOOD) & (qualities >= Quality.GOOD)
    known: NDArray[np.bool_] = (stored.times_us[at] == times_us) & ~mends
    return known


def _bring_back(
    connection: Connection, database: Database, hour: PackedHour, samples: Samples
) -> None:
    packed.remove(connection, hour.channel_id, hour.hour_us)
    rows = packed.rows(samples)
    if rows:
        columns = SampleColumns([hour.channel_id] * len(rows), *zip(*rows, strict=True))
        database.dialect.upsert_samples(connection, columns)


def _due(connection: Connection, end_us: int) -> list[tuple[int, list[int]]]:
    """Find the oldest hour in the table of samples of each channel: hours with their channels."""
    oldest = (
        select(SampleRow.time_us)
        .where(SampleRow.channel_id == ChannelRow.id)
        .order_by(SampleRow.time_us)
        .limit(1)
        .scalar_subquery()
    )
    hours: dict[tuple[str, int], list[int]] = defaultdict(list)
    query = select(ChannelRow.asset, ChannelRow.id, oldest).order_by(ChannelRow.id)
    for asset, channel_id, time_us in connection.execute(query):
        if time_us is not None and time_us - time_us % HOUR_US < end_us:
            hours[asset, time_us - time_us % HOUR_US].append(channel_id)
    return [(hour_us, channel_ids) for (_, hour_us), channel_ids in hours.items()]


def _pack_hour(connection: Connection, channel_ids: Sequence[int], hour_us: int) -> tuple[int, int]:
    """Pack an hour of as many channels as one transaction takes; how many of them, how many done.

    Channels that were read at the same times come into one block.
    """
    groups: dict[bytes, list[tuple[int, Samples]]] = defaultdict(list)
    taken = size = 0
    for channel_id in channel_ids:
        if size >= _MOST:
            break
        taken += 1
        stale = select(StaleRollupRow.hour_us).where(
            StaleRollupRow.channel_id == channel_id, StaleRollupRow.hour_us == hour_us
        )
        if connection.scalar(stale) is not None:
            continue
        samples = _samples(connection, channel_id, hour_us)
        if samples is not None:
            size += samples.times_us.size
            groups[samples.times_us.tobytes()].append((channel_id, samples))
    for group in groups.values():
        block = pack([samples for _, samples in group])
        block_id = connection.execute(
            insert(SampleBlockRow).values(**block._asdict()).returning(SampleBlockRow.id)
        ).scalar_one()
        for position, (channel_id, samples) in enumerate(group):
            # One whose block is damaged, or that another version has left there.
            packed.remove(connection, channel_id, hour_us)
            times_us = samples.times_us
            connection.execute(
                insert(PackedHourRow).values(
                    channel_id=channel_id,
                    hour_us=hour_us,
                    block_id=block_id,
                    position=position,
                    first_us=int(times_us[0]),
                    last_us=int(times_us[-1]),
                    sample_count=times_us.size,
                )
            )
            connection.execute(delete(SampleRow).where(*_in_hour(channel_id, hour_us)))
    return taken, sum(len(group) for group in groups.values())


def _samples(connection: Connection, channel_id: int, hour_us: int) -> Samples | None:
    rows = connection.execute(
        select(SampleRow.time_us, SampleRow.value, SampleRow.quality, SampleRow.received_us)
        .where(*_in_hour(channel_id, hour_us))
        .order_by(SampleRow.time_us)
    ).all()
    if not rows:
        return None
    times_us, values, qualities, received_us = zip(*rows, strict=True)
    return Samples(
        np.array(times_us, np.int64),
        np.array(values, np.float64),  # None becomes not a number
        np.array(qualities, np.uint16),
        np.array([UNKNOWN_US if time is None else time for time in received_us], np.int64),
    )


def _in_hour(channel_id: int, hour_us: int) -> tuple[ColumnElement[bool], ...]:
    return (
        SampleRow.channel_id == channel_id,
        SampleRow.time_us >= hour_us,
        SampleRow.time_us < hour_us + HOUR_US,
    )
