"""Order of the rows of a recording: which of its times a play can follow."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from adapters.times import EARLIEST_US, dated

#: So many rows show the order of a table.
ROWS_LOOKED_AT: Final = 1000
#: Seconds without a row, of the file or of the play, that are said.
GAP_S: Final = 3 * 3600.0
#: A play that goes on so soon says nothing: one of daily means would at every row.
SHORT_WAIT_S: Final = 60.0
#: Steps back that are an order; one may be a clock that was set.
_FEWEST: Final = 2


def said(time_us: int) -> str:
    """Give a time of a recording for a message: a date, or seconds where it has none."""
    return dated(time_us) if time_us >= EARLIEST_US else f"{time_us / 1e6:g} s"


def descent(times_us: Sequence[int]) -> tuple[int, int] | None:
    """First and last of the times if the latest stands first; else None."""
    steps = [after - before for before, after in pairwise(times_us)]
    back = sum(step < 0 for step in steps)
    if back < _FEWEST or back <= sum(step > 0 for step in steps):
        return None
    return (times_us[0], times_us[-1]) if times_us[-1] < times_us[0] else None
