"""Process time: the wall clock, or a faster clock that a virtual bench shares."""

import asyncio
import json
import math
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import structlog

from adapters.protocol import Clock
from adapters.words import shown
from service.files import replacing

MICROSECONDS = 1_000_000
MINUTE_US = 60 * MICROSECONDS
HOUR_US = 60 * MINUTE_US
DAY_US = 24 * HOUR_US
_ANCHOR_FILE = "clock.json"
# Time servers correct a clock by less; process seconds at rate 1.
_CLOCK_SET_S = 1.0
# Wall seconds within which a cell follows a clock that was set, see `service.cell.cell_clock`.
_FOLLOWED_WITHIN_S = 0.5
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LATEST_US = 32_503_680_000_000_000  # the year 3000
_FIRST_MOMENT_US = -62_135_596_800_000_000  # of the year 1
_LAST_MOMENT_US = 253_402_300_799_999_999  # of the year 9999

_log = structlog.get_logger(__name__)


class ClockError(ValueError):
    """The clock cannot go on as it is configured; the text is one line for the user."""


class ProcessClock:
    """Tells process time in UTC microseconds since the epoch.

    At rate 1 it is the system clock. At any other rate it runs ``rate`` process seconds per wall
    second from an anchor, the pair of one wall time and one process time; a service that keeps
    its anchor (`ProcessClock.resume`) finds the same process time after a restart as if it had
    never been away, so no sample is dated before one that is already stored.

    Parameters
    ----------
    rate : float
        Process seconds per wall second, positive.
    anchor : tuple of float and int, optional
        Wall time in seconds since the epoch and the process time in microseconds that belongs to
        it. Default: process time equals wall time now.
    """

    def __init__(self, rate: float = 1.0, anchor: tuple[float, int] | None = None) -> None:
        if not (math.isfinite(rate) and rate > 0):
            raise ValueError(f"clock rate {rate!r}: expected a positive number")
        self.rate = float(rate)
        self._anchor = anchor or (time.time(), wall_us())

    @classmethod
    def resume(cls, rate: float, data_dir: Path) -> "ProcessClock":
        """Continue the process time that a service with this data directory was in.

        A damaged file never stops a start: process time then goes on from the wall clock.

        Parameters
        ----------
        rate : float
            Process seconds per wall second.
        data_dir : pathlib.Path
            Directory that holds the anchor; written when there is none or the rate changed.

        Raises
        ------
        ClockError
            If the system clock is to be followed, but process time is ahead of it already.
        """
        path = data_dir / _ANCHOR_FILE
        earlier = cls._read(path)
        started_us = wall_us()
        begin_us = started_us
        if earlier is not None:
            if earlier.rate == rate:
                return earlier
            reached_us = earlier.now_us()
            ahead_s = (reached_us - started_us) / MICROSECONDS
            if rate == 1.0 and ahead_s > _CLOCK_SET_S:
                raise ClockError(
                    f"clock.rate = 1: the clock of {data_dir} ran at rate {earlier.rate:g} and has "
                    f"reached {rfc3339(reached_us)}, so that times would run a second time; "
                    f"expected clock.rate = {earlier.rate:g}, another service.data_dir, or no file "
                    f"{path} if that is what you want"
                )
            _log.warning(
                "clock_rate_changed", before=earlier.rate, now=rate, at=rfc3339(reached_us)
            )
            begin_us = max(reached_us, started_us)
        if rate == 1.0:
            path.unlink(missing_ok=True)  # else a later run would count this one at that rate
            return cls()
        clock = cls(rate, (started_us / MICROSECONDS, begin_us))
        wall_s, process_us = clock._anchor
        with replacing(path, private=True) as file:
            json.dump({"rate": rate, "wall_s": wall_s, "process_us": process_us}, file)
        return clock

    @classmethod
    def of(cls, data_dir: Path) -> "ProcessClock":
        """Give the time that the service with this data directory is in, also while it is off."""
        return cls._read(data_dir / _ANCHOR_FILE) or cls()

    @classmethod
    def _read(cls, path: Path) -> "ProcessClock | None":
        """Read a kept anchor; None where there is none that makes sense."""
        try:
            kept = json.loads(path.read_bytes())
            wall_s, process_us = kept["wall_s"], kept["process_us"]
            if not (
                isinstance(process_us, int)
                and isinstance(wall_s, float | int)
                and 0 <= process_us < _LATEST_US
                and 0 <= wall_s < _LATEST_US / MICROSECONDS
            ):
                raise ValueError(f"wall_s = {wall_s!r}, process_us = {process_us!r}")
            return cls(kept["rate"], (wall_s, process_us))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, KeyError) as error:
            _log.error("clock_file_damaged", file=str(path), error=str(error))
            return None

    def now_us(self) -> int:
        """Process time in UTC microseconds since the epoch."""
        if self.rate == 1.0:
            return wall_us()
        wall_s, process_us = self._anchor
        return process_us + round((time.time() - wall_s) * self.rate * MICROSECONDS)

    def at_wall_us(self, time_us: int) -> int:
        """Process time at a wall time, both in UTC microseconds since the epoch."""
        if self.rate == 1.0:
            return time_us
        wall_s, process_us = self._anchor
        return process_us + round((time_us - wall_s * MICROSECONDS) * self.rate)

    async def sleep(self, process_seconds: float) -> None:
        """Wait for a span of process time, in seconds."""
        await asyncio.sleep(max(process_seconds, 0.0) / self.rate)


def is_since_set(time_us: int, now_us: int, rate: float) -> bool:
    """Whether a time is one by a clock that was set a moment ago, not one of before.

    A sender of its own may have followed that clock before us.
    """
    return 0 <= now_us - time_us <= _FOLLOWED_WITHIN_S * max(rate, 1.0) * MICROSECONDS


class ClockWatch:
    """Notices that the process clock was set: it moved otherwise than time that passes.

    Parameters
    ----------
    clock : Clock
        Process time.
    wall_s : callable
        Wall seconds of a clock that no one sets.
    """

    def __init__(self, clock: Clock, wall_s: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._wall_s = clock, wall_s
        self._seen_us, self._seen_s = clock.now_us(), wall_s()

    def step_s(self) -> float:
        """Process seconds by which the clock was set since the last look; 0 when it was not."""
        now_us, now_s = self._clock.now_us(), self._wall_s()
        passed_us = (now_s - self._seen_s) * self._clock.rate * MICROSECONDS
        ahead_s = (now_us - self._seen_us - passed_us) / MICROSECONDS
        self._seen_us, self._seen_s = now_us, now_s
        return ahead_s if abs(ahead_s) > _CLOCK_SET_S * max(self._clock.rate, 1.0) else 0.0


def wall_us() -> int:
    """Wall time in UTC microseconds: keys, sessions and the audit trail are dated by it."""
    return time.time_ns() // 1000


def _moment(time_us: int) -> datetime:
    """Moment of a time; the last one of the year 9999 for all that come after, the first before."""
    return _EPOCH + timedelta(microseconds=min(max(time_us, _FIRST_MOMENT_US), _LAST_MOMENT_US))


def rfc3339(time_us: int) -> str:
    """UTC microseconds as RFC 3339 with milliseconds, for example ``2026-11-21T08:00:00.000Z``.

    Years have four digits: what lies beyond them is given as the end of the year 9999.
    """
    moment = _moment(time_us)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def rfc3339_exact(time_us: int) -> str:
    """As `rfc3339`, with microseconds where the time has any: it can be read back as it is.

    The times of stored samples are printed so, for two samples of a channel may lie some
    microseconds apart.
    """
    moment = _moment(time_us)
    timespec = "microseconds" if time_us % 1000 else "milliseconds"
    return moment.isoformat(timespec=timespec).replace("+00:00", "Z")


def from_rfc3339(text: str) -> int:
    """RFC 3339 text as UTC microseconds.

    Raises
    ------
    ValueError
        If the text is not RFC 3339 or has no offset.
    """
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(
            f"time {shown(text)}: expected RFC 3339 such as 2026-11-21T08:00:00Z"
        ) from None
    if moment.tzinfo is None:
        raise ValueError(f"time {shown(text)}: expected an offset, such as Z or +01:00")
    return (moment - _EPOCH) // timedelta(microseconds=1)
