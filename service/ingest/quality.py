"""Checks that a good sample must stand before anybody takes it for good.

A device that says "good" may still be wrong: a loose PT100 wire jumps, a frozen transmitter repeats
itself, a failing one runs away. What physics cannot do makes a sample uncertain: it is stored with
its value, shown with the reason and counted, but no mean, fit or estimate takes it.
"""

import math
import time
from collections.abc import Mapping, Sequence
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


class _Channel:
    """Checks of one channel, with what they remember of it. Times in microseconds."""

    def __init__(self, limits: CheckLimits, machine: _Machine, is_speed: bool) -> None:
        self.reason = ""
        self.quiet_until_s = 0.0
        self.limits = limits
        self.machine = machine
        self._is_speed = is_speed
        self._rate_per_us = limits.max_rate_per_s / 1e6
        # Without a limit on the rate a jump is judged by itself.
        self._allowed_per_us = 0.0 if math.isinf(self._rate_per_us) else self._rate_per_us
        self._flat_us = limits.flat_line_s * 1e6
        self._range = Finding(
            "range",
            Quality.EU_EXCEEDED,
            f"outside the valid range {limits.low:g} to {limits.high:g}",
        )
        self._jump = Finding(
            "jump",
            Quality.SENSOR_NOT_ACCURATE,
            f"jumped by more than {limits.max_jump:g} from one sample to the next",
        )
        self._rate = Finding(
            "rate", Quality.UNCERTAIN, f"changes faster than {limits.max_rate_per_s:g} per second"
        )
        self._flat = Finding(
            "flat_line", Quality.FROZEN, f"frozen: the same value for {limits.flat_line_s:g} s"
        )
        # Recent findings, so that a sample which is sent again gets the same one again.
        self._found: dict[int, Finding] = {}
        self._received_us = 0
        self._forget()

    def _forget(self) -> None:
        self._time_us = -1
        self._level: float | None = None
        self._level_us = 0
        self._suspect, self._suspect_us, self._suspects = 0.0, 0, 0
        self._anchors: tuple[tuple[int, float], tuple[int, float]] | None = None
        self._same_us = 0.0

    def judge(self, sample: Sample) -> Finding | None:
        """Tell what is wrong with a sample that its source calls good."""
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
        return None if self.limits.low <= value <= self.limits.high else self._range

    def _examine(self, time_us: int, value: float) -> Finding | None:
        level, elapsed_us = self._level, time_us - self._level_us
        if level is None:
            self._begin(time_us, value)
            return None
        reach = self.limits.max_jump
        if abs(value - level) > reach + self._allowed_per_us * elapsed_us:
            near = reach + self._allowed_per_us * (time_us - self._suspect_us)
            agrees = self._suspects and abs(value - self._suspect) <= near
            self._suspects = self._suspects + 1 if agrees else 1
            self._suspect, self._suspect_us = value, time_us
            if self._suspects < CONFIRMING_SAMPLES:
                return self._jump
            self._begin(time_us, value)
            return None
        self._suspects = 0
        self._level, self._level_us = value, time_us
        if self._changes_too_fast(time_us, value):
            return self._rate
        if value == level and self.machine.turns:
            # A gap, or a clock that was set, is no proof that a value stood still.
            self._same_us += min(elapsed_us, self._flat_us / FLAT_SAMPLES)
            return self._flat if self._same_us >= self._flat_us else None
        self._same_us = 0.0
        return None

    def _begin(self, time_us: int, value: float) -> None:
        self._level, self._level_us = value, time_us
        self._suspects = 0
        self._anchors = ((time_us, value), (time_us, value))
        self._same_us = 0.0

    def _changes_too_fast(self, time_us: int, value: float) -> bool:
        if self._anchors is None:
            return False
        older, newer = self._anchors
        elapsed_us = time_us - older[0]
        if time_us - newer[0] >= RATE_WINDOW_S * 1e6:
            self._anchors = (newer, (time_us, value))
        if elapsed_us < RATE_WINDOW_S * 1e6:
            return False
        return abs(value - older[1]) > self._rate_per_us * elapsed_us


class QualityChecks:
    """The one place that every sample from outside passes, whatever way it came.

    Parameters
    ----------
    limits : mapping of (str, str) to CheckLimits
        By asset and channel; a channel that is not in it passes.
    registry : prometheus_client.CollectorRegistry
        Where the findings are counted.
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

        Parameters
        ----------
        samples : sequence of Sample
            In the order of their times, as far as the source knows it.
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
                _tell(channel, sample)
        return samples if judged is None else judged

    def reason(self, asset: str, channel: str) -> str:
        """Why the channel's latest sample was doubted; empty when it was not."""
        found = self._channels.get((asset, channel))
        return "" if found is None else found.reason


def _tell(channel: _Channel, sample: Sample) -> None:
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
