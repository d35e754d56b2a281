"""Rows of many channels in one order, read in small batches of each."""

import heapq
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from typing import Protocol, TypeVar


class Timed(Protocol):
    """A row of one channel."""

    @property
    def channel(self) -> str:
        """Its channel."""

    @property
    def time_us(self) -> int:
        """Its time in UTC microseconds."""


Row = TypeVar("Row", bound=Timed)

#: Rows of a batch at least: fewer cost more queries than they save memory.
LEAST_BATCH = 64


def merged(
    channels: Mapping[str, int],
    read: Callable[[str, int, int], list[Row]],
    next_us: Callable[[Row], int],
    first_us: Callable[[str], int],
    limit: int,
) -> list[Row]:
    """Rows of all channels, ascending by time, then by channel name.

    Every channel is read in batches, the next one when the last is used up: memory holds about
    twice the limit, however many channels there are.

    Parameters
    ----------
    channels : mapping of str to int
        Which channels; only the names count.
    read : callable
        Gives rows of a channel in order: its name, from which time on, how many at most.
    next_us : callable
        From which time on to read behind a row.
    first_us : callable
        From which time on to read a channel.
    limit : int
        Rows at most.
    """
    if not channels:
        return []
    batch = limit // len(channels) + LEAST_BATCH

    def walk(name: str) -> Iterator[Row]:
        begin_us = first_us(name)
        while True:
            rows = read(name, begin_us, min(batch, limit))
            yield from rows
            if len(rows) < min(batch, limit):
                return
            begin_us = next_us(rows[-1])

    walks = [walk(name) for name in channels]
    return list(islice(heapq.merge(*walks, key=_order), limit))


def _order(row: Timed) -> tuple[int, str]:
    return row.time_us, row.channel
