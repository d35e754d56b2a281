"""A sequential test on what the observer did not expect: whether the machine still is its model.

The observer's innovations, each divided by its expected spread, are summed up over ten minutes of
operation and divided by the root of their number: standard normal while nothing has changed, and
hardly dependent on each other. `Cusum` adds these sums up in turn. On a machine that is known well
the innovations are far smaller than the observer allows for; inside the low-risk region, from which
the model was identified, they are compared with what they usually are.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from statistics import median

from service.live.kept import KeptChart
from twin_core.cusum import Cusum, threshold_for
from twin_core.observer import Innovation

BLOCK_S = 600.0
ALLOWANCE = 0.5
"""Half the shift that is found soonest, in standard deviations of a block."""
OUTLIER = 3.0
"""No block counts for more: a start or stop is one, a change of the machine is many."""
SMALLEST_SCALE = 0.25
FEWEST_BLOCKS, MOST_BLOCKS = 36, 144
"""What is usual is learnt from the first day of operation on a model, and used after 6 h."""
_MAD_TO_SD = 1.4826
_BLOCKS_PER_1000_H = 1000 * 3600.0 / BLOCK_S


def residual_threshold(false_alarms_per_1000_h: float, channels: int) -> float:
    """Threshold of one sum; two sums of every channel share the false alarms.

    Parameters
    ----------
    false_alarms_per_1000_h : float
        Of all channels together.
    channels : int
        How many.
    """
    run_length = _BLOCKS_PER_1000_H * 2 * max(channels, 1) / false_alarms_per_1000_h
    return threshold_for(run_length, ALLOWANCE)


@dataclass(slots=True)
class ResidualChart:
    """The sequential test of one temperature.

    Attributes
    ----------
    cusum : Cusum
        The sums.
    usual : list of float
        Sizes of the first blocks in the low-risk region.
    total, count, seconds : float
        Sum and number of the normalised innovations of the block so far, and its length.
    risky : bool
        Whether any of the block lies outside the low-risk region.
    """

    cusum: Cusum
    usual: list[float] = field(default_factory=list)
    total: float = 0.0
    count: int = 0
    seconds: float = 0.0
    risky: bool = False

    def add(self, innovation: Innovation, duration_s: float, low_risk: bool) -> None:
        """Take in what the observer did not expect of a step of operation."""
        self.total += innovation.difference_k / innovation.std_k
        self.count += 1
        self.seconds += duration_s
        self.risky |= not low_risk
        if self.seconds < BLOCK_S:
            return
        block = self.total / math.sqrt(self.count)
        usual = self._scale()
        scale = max(usual, 1.0) if self.risky else usual
        self.cusum.add(min(max(block / scale, -OUTLIER), OUTLIER))
        if not self.risky and len(self.usual) < MOST_BLOCKS:
            self.usual.append(abs(block))
        self.total, self.count, self.seconds, self.risky = 0.0, 0, 0.0, False

    def _scale(self) -> float:
        if len(self.usual) < FEWEST_BLOCKS:
            return 1.0
        return max(_MAD_TO_SD * median(self.usual), SMALLEST_SCALE)


class Residuals:
    """The sequential tests of all temperatures of an asset.

    Parameters
    ----------
    threshold : float
        From `residual_threshold`.
    """

    def __init__(self, threshold: float) -> None:
        self.threshold = threshold
        self.charts: dict[str, ResidualChart] = {}

    def expect(self, channels: Iterable[str]) -> None:
        """Have a chart for each of these channels, new ones where there was none."""
        for channel in channels:
            if channel not in self.charts:
                self.charts[channel] = self._new()

    def add(self, innovations: Mapping[str, Innovation], duration_s: float, low_risk: bool) -> None:
        """Take in a step of operation; call it only while the machine runs."""
        self.expect(innovations)
        for channel, innovation in innovations.items():
            self.charts[channel].add(innovation, duration_s, low_risk)

    def restart(self) -> None:
        """Forget everything: another model has other residuals."""
        self.charts = {channel: self._new() for channel in self.charts}

    def to_dict(self) -> dict[str, KeptChart]:
        """Return the whole state as plain JSON types."""
        return {
            channel: {
                "high": chart.cusum.high,
                "low": chart.cusum.low,
                "usual": [round(size, 4) for size in chart.usual],
            }
            for channel, chart in self.charts.items()
        }

    def restore(self, kept: Mapping[str, KeptChart]) -> None:
        """Take up what `to_dict` gave; what does not fit is left aside."""
        for channel, one in kept.items():
            chart = self._new()
            try:
                chart.cusum.high = min(max(float(one["high"]), 0.0), chart.cusum.ceiling)
                chart.cusum.low = min(max(float(one["low"]), 0.0), chart.cusum.ceiling)
                chart.usual = [float(size) for size in one["usual"]][:MOST_BLOCKS]
            except (KeyError, TypeError, ValueError):
                continue
            self.charts[channel] = chart

    def _new(self) -> ResidualChart:
        return ResidualChart(Cusum(ALLOWANCE, 2.0 * self.threshold))
