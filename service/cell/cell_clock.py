"""The clock of a cell: it never steps while spans are counted, and says by how much it was set."""

import asyncio
import json
import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import structlog
from anyio import to_thread

from service.clock import MICROSECONDS, ProcessClock
from service.files import FileError, replacing

Move = Callable[[int], None]
"""Takes by how many microseconds of process time the clock was set."""

#: Wall seconds between two looks at the system clock.
LOOK_WALL_S: Final = 0.25
#: What the system clock is ahead by less than this, in wall seconds, comes from reading two clocks.
_SAME_S: Final = 0.01
#: A time server corrects a clock by less, in wall seconds; by more it was set.
_CLOCK_SET_S: Final = 1.0
_MARK_FILE: Final = "clock_mark.json"
#: Seconds after which a mark that could not be written is tried again.
_MARK_AGAIN_S: Final = 10.0
_BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")
# Of three readings of both clocks the one that took the least time.
_READINGS: Final = 3

_log = structlog.get_logger(__name__)


def unset_s() -> float:
    """Seconds of a clock that no one sets, and that goes on while the machine is suspended."""
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


class CellClock(ProcessClock):
    """Process time for a cell.

    It counts the seconds of a clock that no one sets. When the system clock was set it is set by as
    much, at one moment of the event loop, and all who hold a time from which a span is counted are
    given the microseconds in the same moment: a shelving of an hour lasts an hour, whatever
    happens to the calendar. So it is at a start, when the system clock was set since the last run.
    When the machine itself was started meanwhile, its clock may have been wrong until a time server
    put it right, and no one knows by how much: what was dated before goes by the calendar.

    Parameters
    ----------
    system : ProcessClock
        Process time by the system clock.
    data_dir : pathlib.Path
        Where the mark is kept by which the next run finds what was set between both.
    unset_s : callable
        Seconds of a clock that no one sets.
    boot_id : str, optional
        What that clock counts from: the start of the machine. Empty: it is not known, and nothing
        is known of what was set between two runs.
    """

    def __init__(
        self,
        system: ProcessClock,
        data_dir: Path,
        unset_s: Callable[[], float] = unset_s,
        boot_id: str | None = None,
    ) -> None:
        super().__init__(system.rate)
        self._system, self._unset_s = system, unset_s
        self._boot_id = _boot_id() if boot_id is None else boot_id
        self._mark = data_dir / _MARK_FILE
        self._set_us = round(_CLOCK_SET_S * max(self.rate, 1.0) * MICROSECONDS)
        self._lock = threading.Lock()
        self._move: Move | None = None
        self._is_kept: Callable[[], bool] = lambda: True
        # What is added to the time that has passed, and what was when all that is kept was dated.
        self._offset_us = self._system_offset_us()
        self._marked_us = self._marked_offset_us()
        self._dated_us = self._offset_us if self._marked_us is None else self._marked_us
        # By how much what was loaded of it has been moved.
        self._loaded_us = 0
        self._try_again_s = -math.inf
        self._has_left = False
        #: Whether it is known how what the last run left is dated: since the machine was started.
        self.knows_last_run = self._marked_us is not None

    def now_us(self) -> int:
        """Process time in UTC microseconds since the epoch."""
        return self._offset_us + self._passed_us()

    def at_wall_us(self, time_us: int) -> int:
        """Process time at a wall time, both in UTC microseconds since the epoch."""
        return self._system.at_wall_us(time_us)

    def follow(self) -> None:
        """Follow the system clock; called in the event loop."""
        if self._has_left or not self._lock.acquire(blocking=False):
            return
        try:
            by_us = self._system_offset_us() - self._offset_us
            if abs(by_us) <= _SAME_S * max(self.rate, 1.0) * MICROSECONDS:
                return
            self._offset_us += by_us
            is_set = abs(by_us) > self._set_us
            if is_set:
                _log.warning("clock_set", by_s=round(by_us / MICROSECONDS, 3))
            if not is_set:
                self._dated_us += by_us
            if self._move is not None:
                self._have_moved(self._move)
        finally:
            self._lock.release()

    def since_last_run_us(self) -> int | None:
        """By how many microseconds it was set since the last run: what that left is loaded so.

        None where that is not known.
        """
        self._loaded_us = by_us = self._offset_us - self._dated_us
        if not self.knows_last_run:
            return None
        return by_us if abs(by_us) > self._set_us else 0

    def move_with(self, move: Move, is_kept: Callable[[], bool] = lambda: True) -> None:
        """Have all times moved from which spans are counted, whenever the clock is set.

        Parameters
        ----------
        move : callable
            Called in the event loop; now, in this thread, if the clock was set after
            `since_last_run_us`.
        is_kept : callable
            Whether all that was moved outlives this process; until then no mark says so.
        """
        with self._lock:
            if self._has_left:  # what was loaded is not kept any more
                return
            self._dated_us += self._loaded_us
            self._have_moved(move)
            self._dated_us = self._offset_us
            self._move, self._is_kept = move, is_kept

    def leave(self) -> None:
        """Go on as it is: what is set from now on the next run finds. Callable from any thread."""
        self._has_left = True

    async def run(self) -> None:
        """Follow the system clock until cancelled."""
        while True:
            await asyncio.sleep(LOOK_WALL_S)
            self.follow()
            # It waits for the disk.
            if self._is_mark_due() and self._unset_s() >= self._try_again_s:
                await to_thread.run_sync(self.keep_mark)

    def _have_moved(self, move: Move) -> None:
        by_us = self._offset_us - self._dated_us
        if abs(by_us) > self._set_us:
            self._dated_us = self._offset_us
            move(by_us)

    def _is_mark_due(self) -> bool:
        if self._move is None or not self._boot_id or not self._is_kept():
            return False
        return self._marked_us is None or abs(self._dated_us - self._marked_us) > self._set_us / 2

    def _passed_us(self) -> int:
        return round(self._unset_s() * self.rate * MICROSECONDS)

    def _system_offset_us(self) -> int:
        """By how much the time of the system clock is more than what has passed."""
        found = []
        for _ in range(_READINGS):
            before_us = self._passed_us()
            system_us = self._system.now_us()
            took_us = self._passed_us() - before_us
            found.append((took_us, system_us - before_us - took_us // 2))
        return min(found)[1]

    def _marked_offset_us(self) -> int | None:
        """The offset by which the last run dated what it left; None where that is not known."""
        try:
            kept = json.loads(self._mark.read_bytes())
            boot_id, rate, offset_us = kept["boot_id"], kept["rate"], kept["offset_us"]
            if not isinstance(offset_us, int):
                raise TypeError(f"offset_us {offset_us!r}: expected a whole number")
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, KeyError) as error:
            _log.error("clock_file_damaged", file=str(self._mark), error=str(error))
            return None
        if not self._boot_id or (boot_id, rate) != (self._boot_id, self.rate):
            return None
        by_us = self._offset_us - offset_us
        if abs(by_us) > self._set_us:
            _log.warning("clock_set_since_the_last_run", by_s=round(by_us / MICROSECONDS, 3))
        return offset_us

    def keep_mark(self) -> None:
        """Write for the next run how what is kept is dated, if that has changed."""
        if not self._is_mark_due():
            return
        dated_us = self._dated_us
        mark = {"boot_id": self._boot_id, "rate": self.rate, "offset_us": dated_us}
        try:
            with replacing(self._mark, private=True) as file:
                json.dump(mark, file)
        except FileError as error:
            _log.error("clock_mark_not_kept", error=str(error), again_in_s=_MARK_AGAIN_S)
            self._try_again_s = self._unset_s() + _MARK_AGAIN_S
        else:
            self._marked_us = dated_us


def _boot_id() -> str:
    try:
        return _BOOT_ID.read_text("ascii").strip()
    except (OSError, ValueError):
        return ""
