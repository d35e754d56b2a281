"""Which times a sample can have: one rule for files, pushes, recordings and devices."""

from datetime import UTC, datetime, timedelta
from typing import Final

#: 1990-01-01T00:00:00Z. What is earlier is the time of a clock that was never set, or no time.
EARLIEST_US: Final = 631_152_000_000_000
_AHEAD_US: Final = 86_400_000_000

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)

#: Wall seconds that the clock of a source may be ahead of ours: what it sends is taken as it is.
SOURCE_AHEAD_S: Final = 5.0

POSSIBLE: Final = "a time from 1990 to tomorrow"


def is_possible(time_us: int, now_us: int) -> bool:
    """Whether a sample can be of a time, both UTC microseconds of process time."""
    return EARLIEST_US <= time_us <= latest_us(now_us)


def latest_us(now_us: int) -> int:
    """Latest time that a sample can be of."""
    return now_us + _AHEAD_US


def source_limit_us(now_us: int, rate: float) -> int:
    """Latest time that a source with a right clock can send now; ``rate`` of process time."""
    return now_us + round(SOURCE_AHEAD_S * max(rate, 1.0) * 1e6)


def clock_ahead(ahead_s: float) -> str:
    """Say in words that the clock of a source is so many seconds ahead."""
    return f"the clock of its source is ahead by {ahead_s:.0f} s"


def dated(time_us: int) -> str:
    """Give a time for a message, however impossible it is."""
    try:
        return (_EPOCH + timedelta(microseconds=time_us)).isoformat()
    except OverflowError:
        return "a year of more than four digits" if time_us > 0 else "a year before the first"
