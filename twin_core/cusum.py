"""Cumulative sums (Page 1954): a sequential test for a shift of the mean of standard normal values.

Its threshold is found from the average number of values between two false alarms, by Siegmund's
approximation (D. Siegmund, Sequential Analysis, 1985, eq. 2.19; D. C. Montgomery, Introduction to
Statistical Quality Control, section 9.1.3).
"""

import math
from dataclasses import dataclass

# The excess over the boundary at the end, on average.
_OVERSHOOT = 1.166
_LONGEST_RUN = 1e12


@dataclass(slots=True)
class Cusum:
    """Two one-sided sums: how far the values have drifted above and below zero."""

    #: What each value is excused, in standard deviations: half the shift to be found soonest.
    allowance: float
    #: No sum grows beyond it, so that it comes down again in time after the shift has gone.
    ceiling: float
    high: float = 0.0
    low: float = 0.0

    @property
    def value(self) -> float:
        """The greater of the two sums."""
        return max(self.high, self.low)

    def add(self, value: float) -> None:
        """Take in one value, standard normal while nothing has changed."""
        self.high = min(max(self.high + value - self.allowance, 0.0), self.ceiling)
        self.low = min(max(self.low - value - self.allowance, 0.0), self.ceiling)

    def reset(self) -> None:
        """Begin again."""
        self.high = self.low = 0.0


def average_run_length(threshold: float, allowance: float, shift: float = 0.0) -> float:
    """Average number of values until one one-sided sum exceeds a threshold.

    `threshold`, `allowance`: in standard deviations; `shift`: mean of the values, in standard
    deviations; 0: until a false alarm.
    """
    drift = shift - allowance
    reach = threshold + _OVERSHOOT
    if abs(drift) < 1e-9:
        return reach**2
    return (math.exp(-2.0 * drift * reach) + 2.0 * drift * reach - 1.0) / (2.0 * drift**2)


def threshold_for(run_length: float, allowance: float) -> float:
    """Threshold at which a one-sided sum gives a false alarm once in this many values on average.

    `run_length`: between 2 and 1e12 values; `allowance`: in standard deviations, above 0.
    """
    if not (2.0 <= run_length <= _LONGEST_RUN and allowance > 0.0):
        raise ValueError(
            f"run_length {run_length:g}, allowance {allowance:g}: expected 2 to {_LONGEST_RUN:g} "
            "and more than 0"
        )
    # Halved until nothing is left between: the length grows with the threshold.
    low, high = -_OVERSHOOT, (math.log(_LONGEST_RUN) + 10.0) / (2.0 * allowance)
    while low < (middle := 0.5 * (low + high)) < high:
        if average_run_length(middle, allowance) < run_length:
            low = middle
        else:
            high = middle
    return middle
