"""What a forecast says of each step ahead: how likely a limit is exceeded, or only left behind."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from adapters.samples import PlanStep
from service.live.presentation import LimitCrossing, LimitCrossings
from service.live.profiles import StepAhead
from service.site.asset_section import LimitsSection
from twin_core.forecasting import Forecast

# Steps of one and the same operating point count as one.
_SAME_RPM, _SAME_N = 1.0, 1.0
# Of the upper bound, before a step may be said only to cool; and what its median must fall.
_LET_RISE_K, _MUST_FALL_K = 0.5, 0.5
# A step that begins so close below the warning leaves it behind, too.
_NEAR_K = 1.0
# At the quantiles of a forecast: 2.5, 25, 50, 75 and 97.5 %.
_NORMAL_SCORES = np.array([NormalDist().inv_cdf(p) for p in (0.025, 0.25, 0.5, 0.75, 0.975)])
_MEDIAN, _HIGHEST = 2, -1


@dataclass(frozen=True, slots=True)
class ChannelOutlook:
    """One limited temperature within one step ahead.

    Attributes
    ----------
    warning, alarm : LimitCrossing
        How likely and when the limit is exceeded within the step; times in seconds from the
        moment at which the forecast was made.
    upper_c : float
        Highest upper bound (97.5 %) within the step.
    cools : bool
        Whether the step begins at or above the warning (or within 1 K), brings the median below
        it and raises nothing.
    begins_over : bool
        Whether the median is at or above the warning where the step begins.
    left : tuple of (float, LimitCrossing)
        Of one that cools: the warning from a time on to the end of the step. What is left behind
        is not ahead any more.
    """

    warning: LimitCrossing
    alarm: LimitCrossing
    upper_c: float
    cools: bool
    begins_over: bool = False
    left: tuple[tuple[float, LimitCrossing], ...] = ()

    def from_time(self, time_s: float) -> "ChannelOutlook":
        """The same of what is left of the step at a time."""
        passed = [crossing for at_s, crossing in self.left if at_s <= time_s]
        return replace(self, warning=passed[-1]) if passed else self


@dataclass(frozen=True, slots=True)
class StepOutlook:
    """One step ahead.

    Attributes
    ----------
    start_s, end_s : float
        Seconds from the moment at which the forecast was made.
    speed_rpm, load_n : float
        Its operating point.
    channels : mapping of str to ChannelOutlook
        Every limited temperature.
    plan : PlanStep or None
        What the controller plans for it, with the whole time that is left of it, also beyond the
        horizon; None where nothing is planned.
    """

    start_s: float
    end_s: float
    speed_rpm: float
    load_n: float
    channels: Mapping[str, ChannelOutlook]
    plan: PlanStep | None = None

    def from_time(self, time_s: float) -> "StepOutlook":
        """The same of what is left of the step at a time."""
        if not any(channel.left for channel in self.channels.values()):
            return self
        left = {name: channel.from_time(time_s) for name, channel in self.channels.items()}
        return replace(self, channels=left)


@dataclass(frozen=True, slots=True)
class Outlook:
    """What a live forecast says of the limits.

    Attributes
    ----------
    made_us : int
        Process time from which its seconds count.
    model_version : int
        Of the model that it was made with.
    steps : tuple of StepOutlook
        Every distinct step.
    crossings : mapping
        Limits over the whole horizon, by channel and level.
    """

    made_us: int
    model_version: int
    steps: tuple[StepOutlook, ...]
    crossings: LimitCrossings


def step_outlooks(
    forecast: Forecast, steps: Sequence[StepAhead], limits: Mapping[str, LimitsSection]
) -> tuple[StepOutlook, ...]:
    """Judge every distinct step of a forecast.

    Parameters
    ----------
    forecast : Forecast
        The forecast; its rows hold every change of step.
    steps : sequence of Step
        What it follows.
    limits : mapping of str to LimitsSection
        By sensor or node.
    """
    return tuple(
        StepOutlook(
            start_s,
            end_s,
            step.speed_rpm,
            step.load_n,
            {
                name: _channel(forecast, name, pair, start_s, end_s)
                for name, pair in limits.items()
                if name in forecast.names
            },
            step.plan,
        )
        for start_s, end_s, step in _distinct(steps)
    )


def _distinct(steps: Sequence[StepAhead]) -> list[tuple[float, float, StepAhead]]:
    merged: list[tuple[float, float, StepAhead]] = []
    end_s = 0.0
    for step in steps:
        start_s, end_s = end_s, end_s + step.duration_s
        if merged:
            first_s, _, last = merged[-1]
            before, after = last.plan or last, step.plan or step
            if same_point(before.speed_rpm, before.load_n, after.speed_rpm, after.load_n):
                merged[-1] = first_s, end_s, _longer(last, step)
                continue
        merged.append((start_s, end_s, step))
    return merged


def same_point(
    speed_rpm: float, load_n: float, other_speed_rpm: float, other_load_n: float
) -> bool:
    """Return whether two steps have one and the same operating point."""
    return abs(speed_rpm - other_speed_rpm) < _SAME_RPM and abs(load_n - other_load_n) < _SAME_N


def _longer(step: StepAhead, following: StepAhead) -> StepAhead:
    if step.plan is None or following.plan is None:
        return step
    whole_s = step.plan.duration_s + following.plan.duration_s
    return replace(step, plan=step.plan._replace(duration_s=whole_s))


def _channel(
    forecast: Forecast, name: str, pair: LimitsSection, start_s: float, end_s: float
) -> ChannelOutlook:
    rows = np.flatnonzero((forecast.time_s >= start_s - 1e-3) & (forecast.time_s <= end_s + 1e-3))
    quantiles = forecast.quantile(name)[:, rows]
    cools = _cools(quantiles, pair.warning)
    return ChannelOutlook(
        warning=_exceeded(forecast, name, pair.warning, rows),
        alarm=_exceeded(forecast, name, pair.alarm, rows),
        upper_c=float(np.max(quantiles[_HIGHEST])),
        cools=cools,
        left=_left(forecast, name, pair.warning, rows) if cools else (),
        begins_over=bool(quantiles[_MEDIAN, 0] >= pair.warning),
    )


def _left(
    forecast: Forecast, name: str, limit_c: float, rows: NDArray[np.intp]
) -> tuple[tuple[float, LimitCrossing], ...]:
    """The limit from each row on, until nothing exceeds it."""
    found: list[tuple[float, LimitCrossing]] = []
    for first in range(rows.size):
        crossing = _exceeded(forecast, name, limit_c, rows[first:])
        found.append((float(forecast.time_s[rows[first]]), crossing))
        if crossing.probability == 0.0:
            break
    return tuple(found)


def _exceeded(
    forecast: Forecast, name: str, limit_c: float, rows: NDArray[np.intp]
) -> LimitCrossing:
    time_s = forecast.time_s[rows]
    if name in forecast.sensors:
        found = forecast.exceedance(name, limit_c, time_s[0], time_s[-1])
        return LimitCrossing(found.probability, found.median_s, found.earliest_s)
    # Of a node no members are kept: the share of them is read from its quantiles.
    quantiles = forecast.quantile(name)[:, rows]
    shares = np.array([share_over(column, limit_c) for column in quantiles.T])
    return LimitCrossing(
        float(np.max(shares)), _first_s(time_s, shares, 0.5), _first_s(time_s, shares, 0.025)
    )


def _first_s(
    time_s: NDArray[np.float64], shares: NDArray[np.float64], share: float
) -> float | None:
    over = np.flatnonzero(shares >= share)
    return float(time_s[over[0]]) if over.size else None


def share_over(quantiles: NDArray[np.float64], limit_c: float) -> float:
    """Probability of a value over a limit, from its five quantiles on the normal scale."""
    if not np.isfinite(quantiles).all():
        return 1.0
    upper = int(np.clip(np.searchsorted(quantiles, limit_c), 1, quantiles.size - 1))
    low, high = quantiles[upper - 1], quantiles[upper]
    if high - low < 1e-9:
        return 0.0 if limit_c > high else 1.0
    share = (limit_c - low) / (high - low)
    step = _NORMAL_SCORES[upper] - _NORMAL_SCORES[upper - 1]
    return 1.0 - NormalDist().cdf(_NORMAL_SCORES[upper - 1] + share * step)


def _cools(quantiles: NDArray[np.float64], warning_c: float) -> bool:
    median, highest = quantiles[_MEDIAN], quantiles[_HIGHEST]
    return bool(
        median[0] >= warning_c - _NEAR_K
        and median[-1] < min(warning_c, median[0] - _MUST_FALL_K)
        and np.max(highest) - highest[0] <= _LET_RISE_K
    )
