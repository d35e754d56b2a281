"""What the values of a channel can do: as configured, by physics, and by what the machine is."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from adapters.configuration import MeasuredChannel, SourceConfig
from service.domain.channels import AMBIENT
from service.site.machines.operating_ranges import TEMPERATURE_C, Range, refused_beyond

# A PT100 in a bearing of this size follows with a time constant of seconds, and all the friction
# heat of its highest speed and load, put into one ring alone, warms that by less than 2 K/s.
_TEMPERATURE_RATE_K_PER_S = 2.0
_TEMPERATURE_JUMP_K = 5.0
# While a machine runs, noise and the ambient's air move a reading of this resolution sooner.
_TEMPERATURE_FLAT_S = 1800.0
_FLAT_RESOLUTION_K = 0.2


@dataclass(frozen=True, slots=True)
class CheckLimits:
    """What the values of one channel can do, in the channel's unit; infinite: anything.

    - ``low``, ``high``: least and greatest plausible value.
    - ``max_jump``: greatest change from one sample to the next, on top of `max_rate_per_s`.
    - ``max_rate_per_s``: greatest lasting change per process second.
    - ``flat_line_s``: process seconds for which a running machine may give exactly the same value.
    """

    low: float = -math.inf
    high: float = math.inf
    max_jump: float = math.inf
    max_rate_per_s: float = math.inf
    flat_line_s: float = math.inf

    @property
    def anything(self) -> bool:
        """Whether there is nothing to check."""
        return self == CheckLimits()


def limits_of(name: str, source: SourceConfig, channel: MeasuredChannel) -> CheckLimits:
    """Return what a channel's values can do: as configured, else what a temperature can."""
    jump = rate = flat = 0.0
    # A record that is played faster than it happened changes as much faster.
    if name.endswith("_c") and source.speed_up <= 1.0:
        jump, rate = _TEMPERATURE_JUMP_K, _TEMPERATURE_RATE_K_PER_S
        is_coarse = channel.resolution > _FLAT_RESOLUTION_K
        flat = 0.0 if name == AMBIENT or is_coarse else _TEMPERATURE_FLAT_S
    low, high = channel.valid_range or (-math.inf, math.inf)
    return CheckLimits(
        low,
        high,
        _or_nothing(channel.max_jump, jump),
        _or_nothing(channel.max_rate_per_s, rate),
        _or_nothing(channel.flat_line_s, flat),
    )


def _or_nothing(configured: float | None, default: float) -> float:
    """Limit as configured, else by default; 0 is no limit."""
    return (default if configured is None else configured) or math.inf


def within_machine(name: str, limits: CheckLimits, ranges: Mapping[str, Range]) -> CheckLimits:
    """Let no speed, load or temperature be good that the machine cannot have.

    A configured `valid_range` counts up to `REFUSED_BEYOND` times the default one.
    """
    if name.startswith("t_"):
        ranges = {name: TEMPERATURE_C}
    if name not in ranges:
        return limits
    configured = math.isfinite(limits.low) or math.isfinite(limits.high)
    low, high = (refused_beyond(ranges) if configured else ranges)[name]
    return replace(limits, low=max(limits.low, low), high=min(limits.high, high))
