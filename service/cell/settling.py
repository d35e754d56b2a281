"""Holds kept forecasts against what was measured, as their times come."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from service.clock import HOUR_US, MICROSECONDS, MINUTE_US
from service.domain.channels import LOAD, SPEED
from service.store import Store
from service.store.forecast_records import (
    SET_ASIDE,
    Outcome,
    PointState,
    Settled,
    StoredForecast,
    degrees,
)
from twin_core.verification import MinuteCourse, minute_course, value_at

#: Forecasts that are looked at in one go.
AT_ONCE = 200
#: Process seconds after a reading's time in which its samples come into the store, and the wall
#: seconds that drivers and writer may hold them.
SETTLING_S, SETTLING_WALL_S = 120.0, 2.0
#: Process seconds for which data that are not there are waited for, as a gateway may bring them
#: later, and after which they are looked for again at the earliest.
WAITS_FOR_DATA_S, LOOKS_AGAIN_S = 6 * 3600.0, 600.0
_WAITS_US = round(WAITS_FOR_DATA_S * 1e6)
#: The minutes around a reading's time are over so much later at the latest.
_AROUND_US = 90 * MICROSECONDS
#: Minutes that are read again for what comes late, and process time that is kept at hand.
_READ_AGAIN_US, _AT_HAND_US = 2 * MINUTE_US, 5 * HOUR_US


@dataclass(frozen=True, slots=True)
class News:
    """What became of one reading of a forecast.

    Attributes
    ----------
    lead_time_s, high_risk
        Which it is.
    state
        Scored or set aside.
    inside
        Whether it was measured inside the 95 % band; None where it is set aside.
    """

    lead_time_s: int
    high_risk: bool
    state: PointState
    inside: bool | None


@dataclass(slots=True)
class _Minutes:
    """Means of the minutes of an asset from a time on, by channel; NaN where there is none."""

    start_us: int
    count: int = 0
    means: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    @property
    def end_us(self) -> int:
        return self.start_us + self.count * MINUTE_US

    def trim(self, start_us: int, end_us: int) -> None:
        """Leave out what comes before and after."""
        first = max((start_us - self.start_us) // MINUTE_US, 0)
        last = max(min((end_us - self.start_us) // MINUTE_US, self.count), first)
        self.means = {name: values[first:last] for name, values in self.means.items()}
        self.start_us += first * MINUTE_US
        self.count = last - first

    def append(self, end_us: int, means: Mapping[str, Mapping[int, float]]) -> None:
        """Add the minutes up to a time."""
        begin_us, count = self.end_us, max((end_us - self.end_us) // MINUTE_US, 0)
        for name, of_minute in means.items():
            values = np.full(count, np.nan)
            for minute_us, value in of_minute.items():
                if begin_us <= minute_us < end_us:
                    values[(minute_us - begin_us) // MINUTE_US] = value
            self.means[name] = np.concatenate((self.means.get(name, np.empty(0)), values))
        self.count += count


class Settling:
    """Looks at forecasts whose times have come.

    What was measured in the last hours is kept at hand, so that each minute is read from the store
    about once, and those of many assets together, however many forecasts they belong to.

    Parameters
    ----------
    store : Store
        Where forecasts and samples are.
    rate : float
        Process seconds per wall second.
    """

    def __init__(self, store: Store, rate: float) -> None:
        self._store = store
        self._margin_us = round((SETTLING_S + SETTLING_WALL_S * rate) * 1e6)
        self._minutes: dict[str, _Minutes] = {}

    def look(self, now_us: int) -> tuple[bool, list[News]]:
        """Look at forecasts that are due, in one transaction; says whether there may be more.

        Raises
        ------
        StoreUnavailableError
            If the store does not answer; then all is as before.
        """
        ready_us = now_us - self._margin_us
        due = self._store.forecasts.due(ready_us, AT_ONCE)
        by_asset: defaultdict[str, list[StoredForecast]] = defaultdict(list)
        for one in due:
            by_asset[one.issued.asset].append(one)
        end_us = (ready_us + _AROUND_US) // MINUTE_US * MINUTE_US
        self._forget(end_us)
        self._read_on(by_asset, now_us, end_us)
        settled = [
            one
            for asset, forecasts in by_asset.items()
            for one in self._settled_of(asset, forecasts, ready_us, end_us)
        ]
        written = self._store.forecasts.settle(settled)
        before = [one for forecasts in by_asset.values() for one in forecasts]
        news = [
            one
            for was, now in zip(before, settled, strict=True)
            if now.id in written
            for one in _news(was, now.outcome)
        ]
        return len(due) == AT_ONCE, news

    # ------------------------------------------------------------------ what was measured
    def _forget(self, end_us: int) -> None:
        for asset, minutes in list(self._minutes.items()):
            if not 0 <= end_us - minutes.end_us < HOUR_US:
                del self._minutes[asset]

    def _read_on(
        self, by_asset: Mapping[str, Sequence[StoredForecast]], now_us: int, end_us: int
    ) -> None:
        """Read what is new of all assets of which the minutes before are at hand, together."""
        known = {
            asset: minutes
            for asset, minutes in self._minutes.items()
            if asset in by_asset and now_us - minutes.end_us + _READ_AGAIN_US < HOUR_US // 2
        }
        if not known:
            return
        begin_us = min(minutes.end_us for minutes in known.values()) - _READ_AGAIN_US
        channels = {asset: list(minutes.means) for asset, minutes in known.items()}
        means = self._store.history.recent_minute_means(channels, begin_us, end_us)
        for asset, minutes in known.items():
            minutes.trim(end_us - _AT_HAND_US, minutes.end_us - _READ_AGAIN_US)
            minutes.append(end_us, {name: means[asset, name] for name in minutes.means})

    def _minutes_of(
        self, asset: str, forecasts: Sequence[StoredForecast], end_us: int, again: bool = False
    ) -> _Minutes:
        """Give the minutes since the first of these forecasts was made."""
        oldest_us = min(one.issued.time_us for one in forecasts)
        channels = {name for one in forecasts for name in one.issued.content.channels}
        known = self._minutes.get(asset)
        if (
            not again
            and known is not None
            and known.start_us <= oldest_us
            and known.end_us >= end_us
            and channels <= known.means.keys()
        ):
            return known
        start_us = oldest_us // MINUTE_US * MINUTE_US
        if known is not None:
            start_us = min(start_us, known.start_us)
            channels |= known.means.keys()
        names = sorted({SPEED, LOAD, *channels})
        table = self._store.history.minute_averages(asset, names, start_us, end_us)
        minutes = _Minutes(start_us)
        at_us = table.minute_us.tolist()
        minutes.append(
            end_us,
            {name: dict(zip(at_us, table.mean[name].tolist(), strict=True)) for name in names},
        )
        self._minutes[asset] = minutes
        return minutes

    # ------------------------------------------------------------------ one forecast
    def _settled_of(
        self, asset: str, forecasts: Sequence[StoredForecast], ready_us: int, end_us: int
    ) -> Iterable[Settled]:
        """What became of the forecasts of an asset."""
        judged = [one for one in forecasts if one.has_model]
        minutes = self._minutes_of(asset, judged, end_us) if judged else _Minutes(end_us)
        found = [_settled(one, minutes, ready_us) for one in forecasts]
        if any(missing for _, missing in found):
            # It may have come late.
            minutes = self._minutes_of(asset, judged, end_us, again=True)
            found = [_settled(one, minutes, ready_us) for one in forecasts]
        return [one for one, _ in found]


def _settled(forecast: StoredForecast, minutes: _Minutes, ready_us: int) -> tuple[Settled, bool]:
    """What became of a forecast, and whether data of it are missing."""
    issued, content = forecast.issued, forecast.issued.content
    states = [list(row) for row in forecast.outcome.states]
    measured_c = [list(row) for row in forecast.outcome.measured_c]
    next_us: list[int] = []
    missing = False
    course = _course(forecast, minutes) if forecast.has_model else None
    for number, lead_s in enumerate(content.lead_times_s):
        at_us = issued.time_us + lead_s * MICROSECONDS
        waiting = [k for k, state in enumerate(states[number]) if state == "waiting"]
        if not waiting:
            continue
        if course is None:
            _set(states[number], waiting, "model")
        elif at_us > ready_us:
            next_us.append(at_us)
        elif (followed := course.until(lead_s)) == "left":
            _set(states[number], waiting, "plan")
        else:
            for k in waiting:
                value = None
                if followed == "followed":
                    series = minutes.means[content.channels[k]]
                    value = value_at(series, (at_us - minutes.start_us) / MINUTE_US)
                if value is not None:
                    states[number][k], measured_c[number][k] = "scored", round(value, 3)
                elif ready_us >= at_us + _WAITS_US:
                    states[number][k], missing = "data", True
                else:
                    # Ever more rarely: a sensor that is broken may stay so.
                    wait_us = max(round(LOOKS_AGAIN_S * 1e6), ready_us - at_us)
                    next_us.append(min(ready_us + wait_us, at_us + _WAITS_US))
                    missing = True
    due_us = min(next_us, default=None)
    outcome = Outcome(states, measured_c)
    return Settled(forecast.id, forecast.due_us or 0, due_us, outcome), missing


def _set(states: list[PointState], places: Iterable[int], state: PointState) -> None:
    for place in places:
        states[place] = state


def _course(forecast: StoredForecast, minutes: _Minutes) -> MinuteCourse:
    issued = forecast.issued
    first = -(-(issued.time_us - minutes.start_us) // MINUTE_US)
    last = first + issued.content.lead_times_s[-1] // 60
    speed_rpm, load_n = (minutes.means[name][first:last] for name in (SPEED, LOAD))
    begin_s = (minutes.start_us + first * MINUTE_US - issued.time_us) / 1e6
    steps = np.array(issued.content.steps)
    return minute_course(
        steps[:, 0],
        steps[:, 1],
        steps[:, 2],
        begin_s + 60.0 * np.arange(speed_rpm.size),
        speed_rpm,
        load_n,
    )


def _news(before: StoredForecast, after: Outcome) -> Iterable[News]:
    """What was waiting before, and is not any more."""
    content = before.issued.content
    for number, lead_s in enumerate(content.lead_times_s):
        pairs = zip(before.outcome.states[number], after.states[number], strict=True)
        for k, (was, state) in enumerate(pairs):
            if was != "waiting" or state == "waiting":
                continue
            inside = None
            if state not in SET_ASIDE:
                low, *_, high = (degrees(one) for one in content.quantiles[number][k])
                value = after.measured_c[number][k]
                if low is not None and high is not None and value is not None:
                    inside = low <= value <= high
            yield News(lead_s, content.high_risk[number], state, inside)
