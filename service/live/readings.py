"""What the channels of one asset say now, and their means over a step of the twin."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from adapters.samples import Quality, Sample, is_good


@dataclass(slots=True)
class _Mean:
    total: float = 0.0
    count: int = 0


@dataclass(slots=True)
class Readings:
    """Latest sample of each channel and running means since the last step.

    Bad and uncertain samples are kept as the latest word on a channel, so that a screen shows
    them for what they are, but never enter a mean.
    """

    asset: str
    latest: dict[str, Sample] = field(default_factory=dict)
    last_good: dict[str, Sample] = field(default_factory=dict)
    _means: dict[str, _Mean] = field(default_factory=dict)

    def add(self, samples: Iterable[Sample]) -> list[Sample]:
        """Take in samples; returns those of this asset."""
        mine = [sample for sample in samples if sample.asset == self.asset]
        for sample in mine:
            known = self.latest.get(sample.channel)
            if known is not None and sample.time_us < known.time_us:
                continue  # late data belong in the store, not on the screen
            self.latest[sample.channel] = sample
            if is_good(sample.quality) and math.isfinite(sample.value):
                self.last_good[sample.channel] = sample
                mean = self._means.setdefault(sample.channel, _Mean())
                mean.total += sample.value
                mean.count += 1
        return mine

    def take_means(self) -> dict[str, float]:
        """Means of the good samples since the last call, by channel."""
        means = {
            channel: mean.total / mean.count for channel, mean in self._means.items() if mean.count
        }
        self._means.clear()
        return means

    def age_s(self, channel: str, now_us: int) -> float:
        """Process seconds since the channel last had any sample; infinite when it never had."""
        sample = self.latest.get(channel)
        return math.inf if sample is None else (now_us - sample.time_us) / 1e6

    def good_value(self, channel: str, now_us: int, max_age_s: float) -> float | None:
        """Value of the channel if its latest sample is good and fresh, else None."""
        sample = self.latest.get(channel)
        if sample is None or not is_good(sample.quality):
            return None
        return sample.value if self.age_s(channel, now_us) <= max_age_s else None

    def quality(self, channel: str, now_us: int, max_age_s: float) -> int:
        """OPC quality byte of the channel as a reader should see it now.

        A stale good value is no longer good: it turns into "last known", as nothing says that it
        still holds.
        """
        sample = self.latest.get(channel)
        if sample is None:
            return Quality.WAITING_FOR_INITIAL_DATA
        if is_good(sample.quality) and self.age_s(channel, now_us) > max_age_s:
            return Quality.LAST_KNOWN
        return sample.quality
