"""Delays that count process time, but only while the condition is known."""

from service.clock import MICROSECONDS


class Timer:
    """Adds up the process time during which a condition was known to differ from its alarm."""

    def __init__(self) -> None:
        self._total_us = 0
        self._last_us: int | None = None

    def run(self, now_us: int) -> float:
        """Go on counting; returns the seconds so far."""
        if self._last_us is not None:
            self._total_us += max(now_us - self._last_us, 0)
        self._last_us = now_us
        return self._total_us / MICROSECONDS

    def clock_set(self, by_us: int) -> None:
        """Count on as if nothing had happened: the clock was set by so much."""
        if self._last_us is not None:
            self._last_us += by_us

    def pause(self) -> None:
        """Stand still until the condition is known again."""
        self._last_us = None
