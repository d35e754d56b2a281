"""Rate limits: token buckets, one per caller."""

# The library `limits` has no token bucket, keeps each call's time, and goes by the wall clock.

import time
from collections.abc import Callable

from cachetools import TTLCache

_MOST_CALLERS = 4096
_MINUTE_S = 60.0


class RateLimit:
    """A number of calls a minute for each caller, a minute's worth of them at once."""

    def __init__(self, per_minute: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.per_minute = per_minute
        self._clock = clock
        # Calls left and when that was counted; after a minute a caller has all of them again.
        self._left: TTLCache[str, tuple[float, float]] = TTLCache(_MOST_CALLERS, _MINUTE_S, clock)

    def wait_s(self, caller: str) -> float:
        """Seconds until this caller may call again; 0 for now."""
        return max(0.0, 1.0 - self._now_left(caller)) * _MINUTE_S / self.per_minute

    def count(self, caller: str) -> None:
        """Count one call."""
        self._left[caller] = (max(self._now_left(caller) - 1.0, 0.0), self._clock())

    def _now_left(self, caller: str) -> float:
        left, at_s = self._left.get(caller, (self.per_minute, 0.0))
        return min(self.per_minute, left + (self._clock() - at_s) * self.per_minute / _MINUTE_S)
