"""Delays that count process time, but only while the condition is known."""

from service.clock import MICROSECONDS


class Timer:
    """Adds up the process time during which a condition was known to differ from its alarm."""

    def __init__(self) -> None:
        self._total_us = 0
        self._last_us: int | None = None
        # Until when was counted or paused; no time is counted twice.
        self._reached_us: int | None = None
        #: The highest value meanwhile, and when it was.
        self.highest: tuple[float, int] | None = None

    def run(self, now_us: int) -> float:
        """Go on counting; returns the seconds so far."""
        if self._last_us is not None:
            self._total_us += max(now_us - self._last_us, 0)
        self._last_us = self._reached_us = now_us
        return self._total_us / MICROSECONDS

    def run_to(self, sample_us: int) -> float:
        """Count as far as a sample, which may be older than what was counted already."""
        return self.run(sample_us if self._reached_us is None else max(sample_us, self._reached_us))

    @property
    def is_paused(self) -> bool:
        """Whether the condition is not known since the last count."""
        return self._last_us is None

    def note(self, value: float | None, at_us: int) -> None:
        """Note a value of the condition while it lasts."""
        if value is not None and (self.highest is None or value > self.highest[0]):
            self.highest = value, at_us

    def clock_set(self, by_us: int) -> None:
        """Count on as if nothing had happened: the clock was set by so much."""
        if self._last_us is not None:
            self._last_us += by_us
        if self._reached_us is not None:
            self._reached_us += by_us
        if self.highest is not None:
            value, at_us = self.highest
            self.highest = value, at_us + by_us

    def pause(self) -> None:
        """Stand still until the condition is known again."""
        self._last_us = None
