"""Holds kept forecasts against what was measured, as their times come."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.clock import HOUR_US, MINUTE_US
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
from twin_core.verification import MinuteCourse, minute_course

#: Forecasts that are looked at in one go.
AT_ONCE = 200
#: Process seconds after a reading's time in which its samples come into the store, and the wall
#: seconds that drivers and writer may hold them.
SETTLING_S, SETTLING_WALL_S = 60.0, 2.0
#: Process seconds for which data that are not there are waited for: a gateway may bring them later.
WAITS_FOR_DATA_S, LOOKS_AGAIN_S = 6 * 3600.0, 600.0
_HALF_US = MINUTE_US // 2
#: Minutes that are read again, and process time that is kept at hand of an asset.
_READ_AGAIN_US, _AT_HAND_US = 5 * MINUTE_US, 5 * HOUR_US


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
    """Measured speed and load of the minutes from a time on; NaN where there is none."""

    start_us: int
    values: NDArray[np.float64]
    used_us: int

    @property
    def end_us(self) -> int:
        return self.start_us + len(self.values) * MINUTE_US


class Settling:
    """Looks at forecasts whose times have come.

    Speed and load of the last hours are kept at hand, so that each minute is read from the store
    about once, however many forecasts it belongs to.

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
        settled = [
            self._settled(one, ready_us, course)
            for asset, forecasts in by_asset.items()
            for one, course in self._courses(asset, forecasts, ready_us)
        ]
        written = self._store.forecasts.settle(settled)
        for asset, minutes in list(self._minutes.items()):
            if not abs(ready_us - minutes.used_us) < HOUR_US:
                del self._minutes[asset]
        news = [
            one
            for before, after in zip(_flat(by_asset), settled, strict=True)
            if after.id in written
            for one in _news(before, after.outcome)
        ]
        return len(due) == AT_ONCE, news

    # ------------------------------------------------------------------ one forecast
    def _settled(
        self, forecast: StoredForecast, ready_us: int, course: MinuteCourse | None
    ) -> Settled:
        issued, content = forecast.issued, forecast.issued.content
        states = [list(row) for row in forecast.outcome.states]
        measured_c = [list(row) for row in forecast.outcome.measured_c]
        next_us: list[int] = []
        for number, lead_s in enumerate(content.lead_times_s):
            at_us = issued.time_us + lead_s * 1_000_000
            waiting = [k for k, state in enumerate(states[number]) if state == "waiting"]
            if not waiting:
                continue
            if not forecast.has_model:
                for k in waiting:
                    states[number][k] = "model"
                continue
            if at_us > ready_us:
                next_us.append(at_us)
                continue
            followed = "unknown" if course is None else course.until(lead_s)
            if followed == "left":
                for k in waiting:
                    states[number][k] = "plan"
                continue
            names = [content.channels[k] for k in waiting]
            found = {} if followed == "unknown" else self._measured(issued.asset, names, at_us)
            for k in waiting:
                value = found.get(content.channels[k])
                if value is not None:
                    states[number][k], measured_c[number][k] = "scored", value
                elif ready_us - at_us >= WAITS_FOR_DATA_S * 1e6:
                    states[number][k] = "data"
                else:
                    next_us.append(ready_us + round(LOOKS_AGAIN_S * 1e6))
        return Settled(
            forecast.id,
            forecast.due_us or 0,
            min(next_us, default=None),
            Outcome(states, measured_c),
        )

    def _measured(self, asset: str, names: Sequence[str], at_us: int) -> dict[str, float]:
        """Means of the good samples in the minute around a time."""
        begin_us = at_us - _HALF_US
        table = self._store.history.minute_averages(
            asset, names, begin_us, at_us + _HALF_US, begin_us % MINUTE_US
        )
        return {
            name: round(float(values[0]), 3)
            for name, values in table.mean.items()
            if values.size and np.isfinite(values[0])
        }

    # ------------------------------------------------------------------ speed and load
    def _courses(
        self, asset: str, forecasts: Sequence[StoredForecast], ready_us: int
    ) -> Iterable[tuple[StoredForecast, MinuteCourse | None]]:
        """Give each forecast with what the machine did since; None where nothing is known."""
        oldest_us = min(one.issued.time_us for one in forecasts)
        minutes = self._read(asset, oldest_us // MINUTE_US * MINUTE_US, ready_us)
        read_again = False
        for one in forecasts:
            course = _course(one, minutes)
            if not read_again and _is_unknown(one, course, ready_us):
                # What was missing may have come late.
                del self._minutes[asset]
                minutes = self._read(asset, minutes.start_us, ready_us)
                course, read_again = _course(one, minutes), True
            yield one, course

    def _read(self, asset: str, start_us: int, ready_us: int) -> _Minutes:
        end_us = ready_us // MINUTE_US * MINUTE_US
        known = self._minutes.get(asset)
        if known is None or not known.start_us <= start_us <= known.end_us:
            known = _Minutes(start_us, np.empty((0, 2)), ready_us)
        # Other forecasts of the asset began earlier, and come again.
        start_us = min(start_us, max(known.start_us, end_us - _AT_HAND_US))
        keeps = slice(
            (start_us - known.start_us) // MINUTE_US,
            max(len(known.values) - _READ_AGAIN_US // MINUTE_US, 0),
        )
        kept = known.values[keeps]
        from_us = start_us + len(kept) * MINUTE_US
        count = max((end_us - from_us) // MINUTE_US, 0)
        table = self._store.history.minute_averages(
            asset, (SPEED, LOAD), from_us, from_us + count * MINUTE_US
        )
        values = np.full((count, 2), np.nan)
        at = (table.minute_us - from_us) // MINUTE_US
        for column, name in enumerate((SPEED, LOAD)):
            values[at, column] = table.mean[name]
        minutes = _Minutes(start_us, np.concatenate((kept, values)), ready_us)
        self._minutes[asset] = minutes
        return minutes


def _course(forecast: StoredForecast, minutes: _Minutes) -> MinuteCourse | None:
    issued = forecast.issued
    first = -(-(issued.time_us - minutes.start_us) // MINUTE_US)
    values = minutes.values[first : first + issued.content.lead_times_s[-1] // 60]
    if not len(values):
        return None
    begin_s = (minutes.start_us + first * MINUTE_US - issued.time_us) / 1e6
    steps = np.array(issued.content.steps)
    return minute_course(
        steps[:, 0], steps[:, 1], steps[:, 2], begin_s + 60.0 * np.arange(len(values)), *values.T
    )


def _is_unknown(forecast: StoredForecast, course: MinuteCourse | None, ready_us: int) -> bool:
    due_s = (ready_us - forecast.issued.time_us) / 1e6
    leads = [lead for lead in forecast.issued.content.lead_times_s if lead <= due_s]
    return course is not None and any(course.until(lead) == "unknown" for lead in leads)


def _flat(by_asset: Mapping[str, Sequence[StoredForecast]]) -> list[StoredForecast]:
    return [one for forecasts in by_asset.values() for one in forecasts]


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
                inside = (
                    None if low is None or high is None or value is None else low <= value <= high
                )
            yield News(lead_s, content.high_risk[number], state, inside)
