"""Runs of a machine: from the moment it turns until it stands still."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal

TURNS_RPM: Final = 30.0
"""Above this mean speed a machine turns; below it the speed is the noise of a standstill."""
STANDSTILL_S: Final = 300
"""A machine that was seen at standstill, and did not turn for so long, has ended its run."""
GAP_S: Final = 1800
"""Without a reading for longer, the machine's course is not known: the run ends with its data."""
LEAST_S: Final = 120
"""Anything shorter is a jerk or a jog, and no run."""

Ended = Literal["", "standstill", "no data"]


@dataclass(frozen=True, slots=True)
class Stretch:
    """A stretch of time (seconds; the end is not part of it) in which a machine turned, or stood.

    Where the speed is not known there is no stretch.
    """

    begin_s: int
    end_s: int
    turns: bool


@dataclass(frozen=True, slots=True)
class RunSpan:
    """A run: ``end_s`` is None, and ``ended`` is empty, while it goes on."""

    begin_s: int
    end_s: int | None
    ended: Ended


def find_runs(stretches: Iterable[Stretch], now_s: int) -> list[RunSpan]:
    """Find the runs of a machine.

    `stretches`: what is known of its speed, ascending, without overlaps. How it is cut does not
    matter: two stretches that touch and are alike are the same as one. `now_s`: up to when the
    speed is known, or could be known. Runs are ascending; only the last may go on. A run ends where
    the machine was last seen turning. Its end is known to be a standstill, or the data ended while
    it turned.
    """
    found: list[RunSpan] = []
    begin_s: int | None = None
    last_s = 0
    stood = False

    def ended(at_s: int) -> Ended:
        if stood:
            return "standstill" if at_s - last_s >= STANDSTILL_S else ""
        return "no data" if at_s - last_s > GAP_S else ""

    def add(begin_s: int, how: Ended) -> None:
        if last_s - begin_s >= LEAST_S:
            found.append(RunSpan(begin_s, last_s if how else None, how))

    for stretch in stretches:
        if not stretch.turns:
            if begin_s is not None and not stood and stretch.begin_s - last_s > GAP_S:
                # What is seen so late does not change how it ended.
                add(begin_s, "no data")
                begin_s = None
            stood = begin_s is not None
            continue
        if begin_s is not None and (how := ended(stretch.begin_s)):
            add(begin_s, how)
            begin_s = None
        if begin_s is None:
            begin_s = stretch.begin_s
        last_s, stood = stretch.end_s, False
    if begin_s is not None:
        add(begin_s, ended(now_s))
    return found
