"""How fast temperatures rise, from the means of good samples."""

from array import array
from collections.abc import Mapping

_LEAST_POINTS = 3
_LEAST_COVERAGE = 0.7
"""A rate is known when readings cover this share of the window."""
# Temperatures are summed up as whole numbers of this part of a kelvin: such sums are exact, so a
# point that leaves the window leaves nothing behind. No temperature is larger than the greatest.
_PER_K = 1 << 32
_GREATEST = 1e9


class _Window:
    """The points of one temperature, and the sums of a straight line through them."""

    __slots__ = ("_first", "_levels", "_origin_us", "_sums", "_times_us")

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all points."""
        # What lies before the first point has left the window; it is dropped in large pieces.
        self._times_us, self._levels, self._first = array("q"), array("q"), 0
        self._origin_us = 0
        self._sums = (0, 0, 0, 0)

    def add(self, time_us: int, value: float) -> None:
        """Take in a point."""
        times_us = self._times_us
        if times_us and times_us[-1] >= time_us:
            self.clear()  # the clock was set back
            times_us = self._times_us
        if not times_us:
            self._origin_us = time_us
        level = round(min(max(value, -_GREATEST), _GREATEST) * _PER_K)
        times_us.append(time_us)
        self._levels.append(level)
        self._count(1, time_us, level)

    def clock_set(self, by_us: int) -> None:
        """Keep all points: the clock was set by so much."""
        self._times_us = array("q", (time_us + by_us for time_us in self._times_us))
        self._origin_us += by_us

    def leave(self, before_us: int) -> None:
        """Drop the points before a time."""
        times_us = self._times_us
        while self._first < len(times_us) and times_us[self._first] < before_us:
            self._count(-1, times_us[self._first], self._levels[self._first])
            self._first += 1
        if 2 * self._first > len(times_us):
            del times_us[: self._first], self._levels[: self._first]
            self._first = 0

    def rate_k_per_min(self, least_us: float) -> float | None:
        """Slope of the straight line; None if there are few points or they cover less than that."""
        times_us, first = self._times_us, self._first
        count = len(times_us) - first
        if count < _LEAST_POINTS or times_us[-1] - times_us[first] < least_us:
            return None
        times, squares, levels, products = self._sums
        slope = count * products - times * levels
        return round(slope * 60_000_000 / ((count * squares - times * times) * _PER_K), 3)

    def _count(self, sign: int, time_us: int, level: int) -> None:
        since_us = time_us - self._origin_us
        times, squares, levels, products = self._sums
        self._sums = (
            times + sign * since_us,
            squares + sign * since_us * since_us,
            levels + sign * level,
            products + sign * since_us * level,
        )


class RatesOfRise:
    """How fast each temperature rises, over the last minutes.

    Parameters
    ----------
    window_s : float
        Over which a rate is taken, in process seconds.
    """

    def __init__(self, window_s: float) -> None:
        self._window_us = round(window_s * 1e6)
        self._least_us = _LEAST_COVERAGE * self._window_us
        self._windows: dict[str, _Window] = {}

    def add(self, now_us: int, means: Mapping[str, float]) -> None:
        """Take in the means of the good samples of a step, by channel."""
        for channel, value in means.items():
            window = self._windows.get(channel)
            if window is None:
                window = self._windows[channel] = _Window()
            window.add(now_us, value)
        for window in self._windows.values():
            window.leave(now_us - self._window_us)

    def clock_set(self, by_us: int) -> None:
        """Keep what is known of the last minutes: the clock was set by so much."""
        for window in self._windows.values():
            window.clock_set(by_us)

    def rate_k_per_min(self, channel: str) -> float | None:
        """Slope of the straight line through the window; None where too little of it is known."""
        window = self._windows.get(channel)
        return None if window is None else window.rate_k_per_min(self._least_us)
