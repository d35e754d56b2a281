"""What the channels of one asset say now, and their means over a step of the twin."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median

from adapters.samples import Quality, Sample, is_bad, is_good, meaning
from service.clock import is_since_set
from service.domain.alarm_condition import Seen, SinceLastLook
from service.domain.channels import AMBIENT

# Samples received so much before the latest one were received before the clock was set back.
_CLOCK_SET_BACK_US = 1_000_000

#: Data are stale after this many of their usual intervals, but never later than `LONGEST_AGE_S`.
INTERVALS_UNTIL_STALE = 5.0
LONGEST_AGE_S = 1800.0
# The usual interval is the median of this many windows of a second or more; known from the fifth.
_WINDOWS, _FEWEST_WINDOWS, _WINDOW_US = 31, 5, 1_000_000
# No value is stale sooner: at rate 1, and with a clock that runs faster than the wall's, where a
# pause of the processor is that much longer.
_TIGHTEST_WALL_S, _TIGHTEST_FASTER_WALL_S = 1.5, 5.0
# Values of a channel between two looks of the alarms; of more the first go, but for their highest.
_MOST_BETWEEN = 6000


def allowed_age_s(max_age_s: float, rate: float) -> float:
    """Age in process seconds at which data are stale.

    Never tighter than 1.5 wall seconds, or 5 where process time runs faster than the wall's.
    """
    wall_s = _TIGHTEST_WALL_S if rate <= 1.0 else _TIGHTEST_FASTER_WALL_S
    return max(max_age_s, wall_s * rate)


@dataclass(slots=True)
class _Pace:
    """How often something comes of a channel, by its times of receipt."""

    windows_s: deque[float] = field(default_factory=lambda: deque(maxlen=_WINDOWS))
    usual_s: float | None = None
    _since_us: int = 0
    _last_us: int = 0
    _count: int = 0

    def note(self, received_us: int) -> None:
        """Record a receipt; samples received together are one."""
        if received_us == self._last_us:
            return
        if not self._since_us or received_us < self._last_us:
            self._since_us, self._count = received_us, 0
        else:
            self._count += 1
            if received_us - self._since_us >= _WINDOW_US:
                self.windows_s.append((received_us - self._since_us) / 1e6 / self._count)
                self._since_us, self._count = received_us, 0
                if len(self.windows_s) >= _FEWEST_WINDOWS:
                    self.usual_s = median(self.windows_s)
        self._last_us = received_us

    def clock_set(self, by_us: int) -> None:
        """Go on: the clock was set by so much."""
        if self._since_us:
            self._since_us += by_us
            self._last_us += by_us


@dataclass(slots=True)
class _Mean:
    total: float = 0.0
    count: int = 0


@dataclass(slots=True)
class Readings:
    """Latest sample of each channel and running means since the last step.

    Bad and uncertain samples are kept as the latest word on a channel, so that a screen shows
    them for what they are, but never enter a mean.

    Attributes
    ----------
    asset : str
        Whose samples these are.
    max_age_s : mapping of str to float
        Process seconds after which a channel is stale, for every channel of the asset; of one that
        is learned until it is known.
    began_us : int
        Process time from which a channel without any sample is waited for.
    latest : dict of str to Sample
        Newest sample of each channel that had any.
    doubt : callable
        Why the latest sample of a channel is not good, where a check or the source says so; else
        empty.
    ahead_s : callable
        Seconds by which the clock behind a channel's latest sample is ahead; None: it is not.
    late : int
        Samples that came when a newer one of their channel was known already.
    learned_from_s : mapping of str to float
        Channels whose age limit follows their observed interval, with the least it may be.
    rate : float
        Process seconds per wall second.
    """

    asset: str
    max_age_s: Mapping[str, float]
    began_us: int
    latest: dict[str, Sample] = field(default_factory=dict)
    doubt: Callable[[str], str] = lambda channel: ""
    ahead_s: Callable[[str], float | None] = lambda channel: None
    late: int = 0
    learned_from_s: Mapping[str, float] = field(default_factory=dict)
    rate: float = 1.0
    _paces: dict[str, _Pace] = field(default_factory=dict)
    _means: dict[str, _Mean] = field(default_factory=dict)
    _between: dict[str, list[Seen]] = field(default_factory=dict)
    _before: dict[str, float | None] = field(default_factory=dict)
    _taken_us: int = 0

    def __post_init__(self) -> None:
        self._between = {
            channel: []
            for channel in self.max_age_s
            if channel.startswith("t_") or channel == AMBIENT
        }

    def add(self, samples: Iterable[Sample]) -> list[Sample]:
        """Take in samples; returns those of this asset that are news, not late."""
        news: list[Sample] = []
        latest, means, seen = self.latest, self._means, self._between
        for sample in samples:
            asset, channel, time_us, value, quality, received_us = sample
            if asset != self.asset:
                continue
            known = latest.get(channel)
            if known is not None and time_us < known.time_us and self._is_late(sample, known):
                self.late += 1
                continue  # late data belong in the store, not on the screen
            latest[channel] = sample
            news.append(sample)
            # Of what is not older than its receipt no limit need be asked for.
            fresh = time_us >= received_us or (
                self._age_s(sample, received_us) <= self.age_limit_s(channel)
            )
            if fresh and channel in self.learned_from_s:
                pace = self._paces.get(channel)
                if pace is None:
                    pace = self._paces[channel] = _Pace()
                pace.note(received_us)
            if not fresh:
                continue  # a gateway sends what it kept while it was away: not the present
            good = is_good(quality) and math.isfinite(value)
            if channel in seen:
                self._note(sample, known, value if good else None)
            if not good:
                continue
            mean = means.get(channel)
            if mean is None:
                mean = means[channel] = _Mean()
            mean.total += value
            mean.count += 1
        return news

    def clock_set(self, by_us: int, now_us: int) -> None:
        """Let values be as old as before: the clock was set by so much, and it is ``now_us``."""
        self.began_us += by_us
        self._taken_us += by_us
        for channel, sample in self.latest.items():
            if not is_since_set(sample.received_us, now_us, self.rate):
                self.latest[channel] = sample._replace(
                    time_us=sample.time_us + by_us, received_us=sample.received_us + by_us
                )
        for seen in self._between.values():
            # Those at the end may be of a sender that followed the clock before us.
            before = len(seen)
            while before and is_since_set(seen[before - 1][0], now_us, self.rate):
                before -= 1
            seen[:before] = [(at_us + by_us, value) for at_us, value in seen[:before]]
        for pace in self._paces.values():
            pace.clock_set(by_us)

    def take_means(self) -> dict[str, float]:
        """Means of the good samples since the last call, by channel."""
        means = {channel: mean.total / mean.count for channel, mean in self._means.items()}
        self._means.clear()
        return means

    def take_between(self, now_us: int) -> SinceLastLook:
        """What temperatures and ambient were since the last call."""
        for channel, seen in self._between.items():
            sample = self.latest.get(channel)
            if sample is not None and self.is_stale(channel, now_us):
                old_us = self._stale_from_us(sample)
                if old_us >= self._taken_us:
                    seen.append((old_us, None))
        self._taken_us = now_us
        seen_now = {channel: seen for channel, seen in self._between.items() if seen}
        taken = SinceLastLook(seen_now, dict(self._before))
        for channel, seen in seen_now.items():
            self._before[channel] = seen[-1][1]
            self._between[channel] = []
        return taken

    def _note(self, sample: Sample, known: Sample | None, value: float | None) -> None:
        """Note a value for the next look of the alarms, and a gap where the one before was old."""
        seen = self._between[sample.channel]
        at_us = min(sample.time_us, sample.received_us)
        if known is not None:
            old_us = self._stale_from_us(known)
            if old_us < at_us:
                seen.append((old_us, None))
        seen.append((at_us, value))
        if len(seen) >= _MOST_BETWEEN:
            seen[: _MOST_BETWEEN // 2] = _highest(seen[: _MOST_BETWEEN // 2])

    def _stale_from_us(self, sample: Sample) -> int:
        limit_us = round(self.age_limit_s(sample.channel) * 1e6)
        return min(sample.time_us, sample.received_us) + limit_us

    def age_limit_s(self, channel: str) -> float:
        """Process seconds after which the channel is stale, as far as known now."""
        floor_s = self.learned_from_s.get(channel)
        pace = None if floor_s is None else self._paces.get(channel)
        if floor_s is None or pace is None or pace.usual_s is None:
            return self.max_age_s[channel]
        learned_s = min(INTERVALS_UNTIL_STALE * pace.usual_s, LONGEST_AGE_S)
        return allowed_age_s(max(floor_s, learned_s), self.rate)

    def is_silent(self, channel: str, now_us: int) -> bool:
        """Return whether nothing comes of a channel that has spoken: stale, or its line is lost."""
        sample = self.latest.get(channel)
        if sample is None:
            return False
        return sample.quality == Quality.COMM_FAILURE or self.is_stale(channel, now_us)

    def is_stale(self, channel: str, now_us: int) -> bool:
        """Return whether the channel has had no sample, of whatever quality, for too long."""
        sample = self.latest.get(channel)
        age_s = abs(now_us - self.began_us) / 1e6 if sample is None else self._age_s(sample, now_us)
        return age_s > self.age_limit_s(channel)

    def stale_from_us(self, channel: str) -> float:
        """Process time at which the channel is stale if nothing more comes; the first moment of it.

        Infinite for a channel that has sent nothing, and so has no value to lose.
        """
        sample = self.latest.get(channel)
        if sample is None:
            return math.inf
        since_us = min(sample.time_us, sample.received_us)
        return since_us + self.age_limit_s(channel) * 1e6 + 1.0

    def good_value(self, channel: str, now_us: int) -> float | None:
        """Value of the channel if its latest sample is good and fresh, else None."""
        sample = self.latest.get(channel)
        if sample is None or not is_good(sample.quality) or self.is_stale(channel, now_us):
            return None
        return sample.value

    def usable_value(self, channel: str, now_us: int) -> float | None:
        """Value of the channel if there is one and its quality is at least uncertain, else None."""
        if channel not in self.max_age_s or self.quality(channel, now_us) < Quality.UNCERTAIN:
            return None
        return self.latest[channel].value

    def quality(self, channel: str, now_us: int) -> int:
        """OPC quality byte of the channel as a reader should see it now.

        A stale value is no longer good, nor uncertain: it turns into "last known", as nothing
        says that it still holds.
        """
        sample = self.latest.get(channel)
        if sample is None:
            return Quality.WAITING_FOR_INITIAL_DATA
        if not is_bad(sample.quality) and self.is_stale(channel, now_us):
            return Quality.LAST_KNOWN
        return sample.quality

    def without_good_data(self, channels: Iterable[str], now_us: int) -> list[str]:
        """Those of some channels whose latest sample is bad or old, in the order of their names."""
        found = []
        for channel in channels:
            sample = self.latest.get(channel)
            if sample is None or not is_good(sample.quality) or self.is_stale(channel, now_us):
                found.append(channel)
        return sorted(found)

    def reason(self, channel: str, now_us: int) -> str:
        """Say why the channel's value is not good now; empty when it is."""
        quality = self.quality(channel, now_us)
        if is_good(quality):
            return ""
        doubt = "" if self.is_stale(channel, now_us) else self.doubt(channel)
        return doubt or meaning(quality)

    def clock_ahead_s(self, channel: str) -> float | None:
        """Seconds by which the clock is ahead that sent the latest sample; None where it is not.

        None, too, where the sample would be no good one with a right clock.
        """
        sample = self.latest.get(channel)
        if sample is None or sample.quality != Quality.UNCERTAIN:
            return None
        return self.ahead_s(channel)

    def _is_late(self, sample: Sample, known: Sample) -> bool:
        """Whether a sample is older than the known one of its channel.

        Their times say so, but for a clock that was set back: ours, when it was received before the
        known one; or that of its source, when the known one came from the future and nothing newer
        came for a second.
        """
        since_us = sample.received_us - known.received_us
        if since_us < -_CLOCK_SET_BACK_US:
            return False
        was_ahead = known.time_us > known.received_us <= sample.time_us <= sample.received_us
        return not (was_ahead and since_us > _CLOCK_SET_BACK_US * max(self.rate, 1.0))

    @staticmethod
    def _age_s(sample: Sample, now_us: int) -> float:
        """Process seconds between a sample and now, whichever way the clock was set meanwhile.

        A gateway's clock may be ahead of ours: such a sample is as old as its receipt.
        """
        return abs(now_us - min(sample.time_us, sample.received_us)) / 1e6


def _highest(seen: Sequence[Seen]) -> list[Seen]:
    """Give the highest value for a moment: that none was higher is all that is known then."""
    at_us, value = max(seen, key=lambda one: -math.inf if one[1] is None else one[1])
    return [(at_us, value), (at_us, None)]
