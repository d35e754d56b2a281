"""Order of the rows of a recording: which of its times a play can follow."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

from adapters.samples import Sample
from adapters.tables import RowError
from adapters.times import EARLIEST_US, dated

Event = tuple[int, list[Sample]]
Found = Event | RowError

#: So many rows show the order of a table.
ROWS_LOOKED_AT: Final = 1000
#: Seconds without a row, of the file or of the play, that are said.
GAP_S: Final = 3 * 3600.0
#: A play that goes on so soon says nothing: one of daily means would at every row.
SHORT_WAIT_S: Final = 60.0
_GAP_US: Final = round(GAP_S * 1e6)
#: No break of a recording is so long if the next row is where the one before it was.
_FAR_US: Final = 30 * 86_400_000_000
#: Samples of one time that are held back.
_HELD_MAX: Final = 10_000


def said(time_us: int) -> str:
    """Give a time of a recording for a message: a date, or seconds where it has none."""
    return dated(time_us) if time_us >= EARLIEST_US else f"{time_us / 1e6:g} s"


def descent(times_us: Sequence[int]) -> tuple[int, int] | None:
    """First and last of the times if the latest stands first; else None."""
    steps = [after - before for before, after in pairwise(times_us)]
    if sum(step < 0 for step in steps) <= sum(step > 0 for step in steps):
        return None
    return (times_us[0], times_us[-1]) if times_us[-1] < times_us[0] else None


def without_strays(events: Iterator[Found]) -> Iterator[Found]:
    """Leave out a time far ahead of the rows before and behind it: a play would wait for it.

    What stands behind a long gap is held back until the next time shows which of the two it is,
    also where that is an exception.
    """
    held: list[Event] = []
    latest_us: int | None = None
    try:
        for event in events:
            if isinstance(event, RowError):
                yield event
                continue
            time_us = event[0]
            if held and time_us == held[0][0] and len(held) < _HELD_MAX:
                held.append(event)
                continue
            if held:
                held_us = held[0][0]
                is_back = latest_us is None or abs(time_us - latest_us) <= _GAP_US
                if is_back and held_us - time_us > _FAR_US:
                    error = RowError(f"{said(held_us)} is far ahead of the rows beside it")
                    yield from (error for _ in held)
                else:
                    latest_us = held_us
                    yield from held
                held = []
            if latest_us is None or time_us - latest_us > _GAP_US:
                held = [event]
                continue
            latest_us = time_us
            yield event
    except Exception:
        yield from held
        raise
    yield from held
