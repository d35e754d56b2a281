"""Rows of many channels in one order, read in small batches of each."""

import heapq
from collections.abc import Callable, Iterator, Mapping
from itertools import chain, islice
from operator import attrgetter
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

    - ``channels``: which channels; only the names count.
    - ``read``: gives rows of a channel in order: its name, from which time on, how many at most.
    - ``next_us``: from which time on to read behind a row.
    - ``first_us``: from which time on to read a channel.
    """
    if not channels:
        return []
    size = min(limit // len(channels) + LEAST_BATCH, limit)

    def walk(name: str) -> Iterator[Row]:
        rows = first.pop(name)
        while True:
            yield from rows
            if len(rows) < size:
                return
            rows = read(name, next_us(rows[-1]), size)

    first = {name: read(name, first_us(name), size) for name in channels}
    if all(len(rows) < size for rows in first.values()):  # and that is all
        # By the name first, then by the time alone, which leaves the names in their order.
        by_name = chain.from_iterable(first[name] for name in sorted(first))
        return sorted(by_name, key=_time)[:limit]
    walks = [walk(name) for name in channels]
    return list(islice(heapq.merge(*walks, key=_order), limit))


_order = attrgetter("time_us", "channel")
_time = attrgetter("time_us")
