"""Checks that a good sample must stand before anybody takes it for good.

A device that says "good" may still be wrong: a loose PT100 wire jumps, a frozen transmitter repeats
itself, a failing one runs away. What physics cannot do makes a sample uncertain: it is stored with
its value, shown with the reason and counted, but no mean, fit or estimate takes it.
"""

import math
import time
from collections.abc import Mapping, Sequence
from functools import lru_cache
from operator import itemgetter
from typing import NamedTuple

import structlog
from prometheus_client import CollectorRegistry, Counter

from adapters.samples import Quality, Sample, is_good
from service.domain.channels import SPEED
from service.site.check_limits import CheckLimits

#: A level so far from the last one is taken once this many samples in a row agree on it.
CONFIRMING_SAMPLES = 3
#: A rate of change is taken over this many seconds at least: one step of resolution is no rate.
RATE_WINDOW_S = 10.0
#: Samples that a flat line must last for at least, whatever the time between them.
FLAT_SAMPLES = 5
#: Below this speed in rpm a flat line is no fault. Higher than the twin's `STANDING_RPM`: a machine
#: that turns so slowly makes hardly any heat, and its temperatures may stay the same for hours.
AT_REST_RPM = 30.0

#: What a check can find.
REASONS = ("range", "jump", "rate", "flat_line")

_CLOCK_SET_BACK_US = 1_000_000
_REMEMBERED = 1000
_LOG_INTERVAL_S = 10.0
_key = itemgetter(0, 1)

_log = structlog.get_logger(__name__)


class Finding(NamedTuple):
    """Why a sample is not good: kind for counting, OPC DA byte, and words for people."""

    kind: str
    quality: int
    reason: str


class _Machine:
    """What the checks must know of the machine behind a channel."""

    __slots__ = ("turns",)

    def __init__(self) -> None:
        self.turns = False


class _Findings(NamedTuple):
    """What the checks of a channel can find."""

    range: Finding
    jump: Finding
    rate: Finding
    flat: Finding


@lru_cache(maxsize=1024)
def _findings(limits: CheckLimits) -> _Findings:
    """Give what checks with these limits can find: the same for all channels that have them."""
    return _Findings(
        Finding(
            "range",
            Quality.EU_EXCEEDED,
            f"outside the valid range {limits.low:g} to {limits.high:g}",
        ),
        Finding(
            "jump",
            Quality.SENSOR_NOT_ACCURATE,
            f"jumped by more than {limits.max_jump:g} from one sample to the next",
        ),
        Finding(
            "rate", Quality.UNCERTAIN, f"changes faster than {limits.max_rate_per_s:g} per second"
        ),
        Finding(
            "flat_line", Quality.FROZEN, f"frozen: the same value for {limits.flat_line_s:g} s"
        ),
    )


class _Level:
    """The level that a channel is at, and another one until enough samples agree on it."""

    __slots__ = ("_max_jump", "_per_us", "_suspect", "_suspect_us", "_suspects", "time_us", "value")

    def __init__(self, limits: CheckLimits) -> None:
        self.value: float | None = None
        self.time_us = 0
        self._max_jump = limits.max_jump
        # Without a limit on the rate a jump is judged alone.
        rate_per_s = limits.max_rate_per_s
        self._per_us = 0.0 if math.isinf(rate_per_s) else rate_per_s / 1e6
        self._suspect, self._suspect_us, self._suspects = 0.0, 0, 0

    def set(self, time_us: int, value: float) -> None:
        self.value, self.time_us, self._suspects = value, time_us, 0

    def is_far(self, level: float, time_us: int, value: float) -> bool:
        reach = self._max_jump + self._per_us * (time_us - self.time_us)
        return abs(value - level) > reach

    def confirms(self, time_us: int, value: float) -> bool:
        """Whether enough samples in a row agree on a level that is far from the last one."""
        reach = self._max_jump + self._per_us * (time_us - self._suspect_us)
        agrees = self._suspects and abs(value - self._suspect) <= reach
        self._suspects = self._suspects + 1 if agrees else 1
        self._suspect, self._suspect_us = value, time_us
        return self._suspects >= CONFIRMING_SAMPLES


class _Slope:
    """How fast a channel changes, over the window or a little more."""

    __slots__ = ("_max_per_us", "_newer", "_older")

    def __init__(self, limits: CheckLimits) -> None:
        self._max_per_us = limits.max_rate_per_s / 1e6
        self.begin(0, 0.0)

    def begin(self, time_us: int, value: float) -> None:
        self._older = self._newer = time_us, value

    def is_too_steep(self, time_us: int, value: float) -> bool:
        older = self._older
        elapsed_us = time_us - older[0]
        if time_us - self._newer[0] >= RATE_WINDOW_S * 1e6:
            self._older, self._newer = self._newer, (time_us, value)
        if elapsed_us < RATE_WINDOW_S * 1e6:
            return False
        return abs(value - older[1]) > self._max_per_us * elapsed_us


class _Channel:
    """Checks of one channel, with what they remember of it. Times in microseconds."""

    __slots__ = (
        "_findings",
        "_flat_us",
        "_found",
        "_is_speed",
        "_level",
        "_received_us",
        "_same_us",
        "_slope",
        "_time_us",
        "limits",
        "machine",
        "quiet_until_s",
        "reason",
    )

    def __init__(self, limits: CheckLimits, machine: _Machine, is_speed: bool) -> None:
        self.reason = ""
        self.quiet_until_s = 0.0
        self.limits = limits
        self.machine = machine
        self._is_speed = is_speed
        self._flat_us = limits.flat_line_s * 1e6
        self._findings = _findings(limits)
        # Recent findings, so that a sample which is sent again gets the same one again.
        self._found: dict[int, Finding] = {}
        self._received_us = 0
        self._forget()

    def _forget(self) -> None:
        self._time_us = -1
        self._level, self._slope = _Level(self.limits), _Slope(self.limits)
        self._same_us = 0.0

    def judge(self, sample: Sample) -> Finding | None:
        """Say what is wrong with a sample that its source calls good."""
        _, _, time_us, value, _, received_us = sample
        if time_us <= self._time_us:
            if received_us >= self._received_us - _CLOCK_SET_BACK_US:
                # Late, or sent again: what came after it has been judged already.
                return self._found.get(time_us) or self._outside(value)
            self._forget()  # the clock was set back: a new line begins
        finding = self._outside(value) or self._examine(time_us, value)
        self._time_us, self._received_us = time_us, received_us
        if self._is_speed and finding is None:
            self.machine.turns = abs(value) >= AT_REST_RPM
        if finding is not None:
            if len(self._found) >= _REMEMBERED:
                del self._found[next(iter(self._found))]
            self._found[time_us] = finding
        return finding

    def _outside(self, value: float) -> Finding | None:
        return None if self.limits.low <= value <= self.limits.high else self._findings.range

    def _examine(self, time_us: int, value: float) -> Finding | None:
        last = self._level
        level, elapsed_us = last.value, time_us - last.time_us
        if level is None or last.is_far(level, time_us, value):
            if level is not None and not last.confirms(time_us, value):
                return self._findings.jump
            last.set(time_us, value)
            self._slope.begin(time_us, value)
            self._same_us = 0.0
            return None
        last.set(time_us, value)
        if self._slope.is_too_steep(time_us, value):
            return self._findings.rate
        if value == level and self.machine.turns:
            # A gap, or a clock that was set, is no proof that a value stood still.
            self._same_us += min(elapsed_us, self._flat_us / FLAT_SAMPLES)
            return self._findings.flat if self._same_us >= self._flat_us else None
        self._same_us = 0.0
        return None


class QualityChecks:
    """The one place that every sample from outside passes, whatever way it came.

    A channel without limits passes.
    """

    def __init__(
        self, limits: Mapping[tuple[str, str], CheckLimits], registry: CollectorRegistry
    ) -> None:
        self._channels: dict[tuple[str, str], _Channel] = {}
        self._checked: dict[str, tuple[str, ...]] = {}
        by_asset: dict[str, dict[str, CheckLimits]] = {}
        for (asset, channel), of in limits.items():
            by_asset.setdefault(asset, {})[channel] = of
        for asset, channels in by_asset.items():
            self.set_limits(asset, channels)
        self._counter = Counter(
            "bearing_twin_samples_doubted",
            "Samples with good quality from their source that a check rejected.",
            ["asset", "channel", "reason"],
            registry=registry,
        )
        # A chart by reason is there before the first of them; of each channel it would be too many.
        for kind in REASONS:
            self._counter.labels("", "", kind)

    def set_limits(self, asset: str, limits: Mapping[str, CheckLimits]) -> None:
        """Check an asset's channels by these limits from now on; a channel without any passes.

        A channel whose limits stay the same remembers what it has seen.
        """
        checked = {channel: of for channel, of in limits.items() if not of.anything}
        if checked:
            # The speed shows a standstill, also where nothing else is checked of it.
            checked.setdefault(SPEED, CheckLimits())
        before = {
            channel: self._channels.pop((asset, channel))
            for channel in self._checked.pop(asset, ())
        }
        machine = next((one.machine for one in before.values()), _Machine())
        for channel, of in checked.items():
            known = before.get(channel)
            if known is None or known.limits != of:
                known = _Channel(of, machine, channel == SPEED)
            self._channels[asset, channel] = known
        if checked:
            self._checked[asset] = tuple(checked)

    def judge(self, samples: Sequence[Sample]) -> Sequence[Sample]:
        """Return the samples, those that fail a check with a quality that says so.

        They come in the order of their times, as far as the source knows it.
        """
        if not self._channels:
            return samples
        judged: list[Sample] | None = None
        for index, channel in enumerate(map(self._channels.get, map(_key, samples))):
            if channel is None:
                continue
            sample = samples[index]
            finding = channel.judge(sample) if is_good(sample.quality) else None
            if finding is not None:
                judged = list(samples) if judged is None else judged
                judged[index] = sample._replace(quality=int(finding.quality))
                self._counter.labels(sample.asset, sample.channel, finding.kind).inc()
            reason = "" if finding is None else finding.reason
            if reason != channel.reason:
                channel.reason = reason
                _log_finding(channel, sample)
        return samples if judged is None else judged

    def reason(self, asset: str, channel: str) -> str:
        """Why the channel's latest sample was doubted; empty when it was not."""
        found = self._channels.get((asset, channel))
        return "" if found is None else found.reason


def _log_finding(channel: _Channel, sample: Sample) -> None:
    now_s = time.monotonic()
    if now_s >= channel.quiet_until_s:
        channel.quiet_until_s = now_s + _LOG_INTERVAL_S
        _log.warning(
            "samples_doubted" if channel.reason else "samples_good_again",
            asset=sample.asset,
            channel=sample.channel,
            value=sample.value,
            reason=channel.reason or None,
        )
