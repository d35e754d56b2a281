"""How fast temperatures rise, from the means of good samples."""

from collections import deque
from collections.abc import Mapping

import numpy as np

_LEAST_POINTS = 3
_LEAST_COVERAGE = 0.7
"""A rate is known when readings cover this share of the window."""


class RatesOfRise:
    """How fast each temperature rises, over the last minutes.

    Parameters
    ----------
    window_s : float
        Over which a rate is taken, in process seconds.
    """

    def __init__(self, window_s: float) -> None:
        self._window_us = round(window_s * 1e6)
        self._points: dict[str, deque[tuple[int, float]]] = {}

    def add(self, now_us: int, means: Mapping[str, float]) -> None:
        """Take in the means of the good samples of a step, by channel."""
        for channel, value in means.items():
            points = self._points.setdefault(channel, deque())
            if points and points[-1][0] >= now_us:
                points.clear()  # the clock was set back
            points.append((now_us, value))
        for points in self._points.values():
            while points and now_us - points[0][0] > self._window_us:
                points.popleft()

    def rate_k_per_min(self, channel: str) -> float | None:
        """Slope of the straight line through the window; None where too little of it is known."""
        points = self._points.get(channel, deque())
        if (
            len(points) < _LEAST_POINTS
            or points[-1][0] - points[0][0] < _LEAST_COVERAGE * self._window_us
        ):
            return None
        minutes = np.array([(time_us - points[0][0]) / 60e6 for time_us, _ in points])
        values = np.array([value for _, value in points])
        minutes -= minutes.mean()
        return round(float(minutes @ values / (minutes @ minutes)), 3)
