"""Compares kept forecasts with what was measured, as they fall due."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from service.clock import HOUR_US, MICROSECONDS, MINUTE_US
from service.domain.channels import LOAD, SPEED
from service.features.ledger.tables import KeptForecasts, Settled
from service.store import Store
from service.store.forecast_records import (
    SET_ASIDE,
    Interrupted,
    IssuedContent,
    Outcome,
    PointState,
    StoredForecast,
    all_degrees,
    degrees,
)
from twin_core.verification import (
    MINUTE_S,
    FollowedBand,
    InterruptedReading,
    MinuteCourse,
    band_at,
    minute_course,
    value_at,
)

#: Forecasts that are looked at in one go.
BATCH_SIZE = 200
#: Process seconds after a reading's time in which its samples come into the store, and the wall
#: seconds that drivers and writer may hold them.
SCORED_AFTER_S, WRITING_WALL_S = 120.0, 2.0
#: Process seconds for which data that are not there are waited for, as a gateway may bring them
#: later, and after which they are looked for again at the earliest.
DATA_WAIT_S, RETRY_S = 6 * 3600.0, 600.0
_DATA_WAIT_US = round(DATA_WAIT_S * 1e6)
#: The minutes around a reading's time are over so much later at the latest.
_AROUND_US = 90 * MICROSECONDS
#: Minutes that are read again for what comes late, and process time that is kept at hand.
_READ_AGAIN_US, _CACHED_US = 2 * MINUTE_US, 5 * HOUR_US


@dataclass(frozen=True, slots=True)
class Score:
    """What became of one reading of a forecast.

    Attributes
    ----------
    lead_time_s, high_risk
        Which it is.
    state
        Scored or set aside.
    inside
        Whether it was measured inside the 95 % band; None where it is set aside.
    left_inside
        Of one that is set aside: whether it was inside when the plan was followed last; None where
        that is not known.
    """

    lead_time_s: int
    high_risk: bool
    state: PointState
    inside: bool | None
    left_inside: bool | None = None


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


class ForecastScoring:
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
        self._forecasts = store.part(KeptForecasts)
        self._margin_us = round((SCORED_AFTER_S + WRITING_WALL_S * rate) * 1e6)
        self._minutes: dict[str, _Minutes] = {}

    def look(self, now_us: int) -> tuple[bool, list[Score]]:
        """Look at forecasts that are due, in one transaction; says whether there may be more.

        Raises
        ------
        StoreUnavailableError
            If the store does not answer; then all is as before.
        """
        ready_us = now_us - self._margin_us
        due = self._forecasts.due(ready_us, BATCH_SIZE)
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
        written = self._forecasts.settle(settled)
        before = [one for forecasts in by_asset.values() for one in forecasts]
        scores = [
            one
            for was, now in zip(before, settled, strict=True)
            if now.id in written
            for one in _scores_of(was, now.outcome)
        ]
        return len(due) == BATCH_SIZE, scores

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
            minutes.trim(end_us - _CACHED_US, minutes.end_us - _READ_AGAIN_US)
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
    came = _Came.of(forecast)
    next_us: list[int] = []
    missing = False
    course = _course(forecast, minutes) if forecast.has_model else None
    followed_bands = None if course is None else _followed_bands(forecast, minutes, course)
    for number, lead_s in enumerate(content.lead_times_s):
        at_us = issued.time_us + lead_s * MICROSECONDS
        states = came.states[number]
        waiting = [k for k, state in enumerate(states) if state == "waiting"]
        if not waiting:
            continue
        if course is None or followed_bands is None:
            _set(states, waiting, "model")
        elif at_us > ready_us:
            next_us.append(at_us)
        elif (followed := course.until(lead_s)) == "left":
            _set(states, waiting, "plan")
            for k in waiting:
                if (band := followed_bands[k]) is not None:
                    came.interrupt(number, k, band, band.left(lead_s))
        else:
            for k in waiting:
                value, band = None, followed_bands[k]
                if followed == "followed":
                    series = minutes.means[content.channels[k]]
                    value = value_at(series, (at_us - minutes.start_us) / MINUTE_US)
                if value is not None:
                    states[k], came.measured_c[number][k] = "scored", round(value, 3)
                    came.runs[number][k] = None if band is None else band.run_inside(lead_s)
                elif ready_us >= at_us + _DATA_WAIT_US:
                    states[k], missing = "data", True
                    if band is not None:
                        came.interrupt(number, k, band, band.lost_above(lead_s))
                else:
                    # Ever more rarely: a sensor that is broken may stay so.
                    wait_us = max(round(RETRY_S * 1e6), ready_us - at_us)
                    next_us.append(min(ready_us + wait_us, at_us + _DATA_WAIT_US))
                    missing = True
    due_us = min(next_us, default=None)
    return Settled(forecast.id, forecast.due_us or 0, due_us, came.outcome()), missing


@dataclass(frozen=True, slots=True)
class _Came:
    """An outcome that is being added to."""

    states: list[list[PointState]]
    measured_c: list[list[float | None]]
    interrupted: list[list[Interrupted | None]]
    runs: list[list[bool | None]]

    @classmethod
    def of(cls, forecast: StoredForecast) -> "_Came":
        outcome, content = forecast.outcome, forecast.issued.content
        leads, count = len(content.lead_times_s), len(content.channels)
        return cls(
            [list(row) for row in outcome.states],
            [list(row) for row in outcome.measured_c],
            [list(row) for row in outcome.interrupted or [[None] * count] * leads],
            [list(row) for row in outcome.runs or [[None] * count] * leads],
        )

    def interrupt(
        self, number: int, place: int, band: FollowedBand, reading: InterruptedReading | None
    ) -> None:
        """Add a reading that was interrupted, and the run up to it, which it ends."""
        if reading is None:
            return
        self.interrupted[number][place] = Interrupted(
            reading.after_s,
            round(reading.measured_c, 3),
            round(reading.low_c, 3),
            round(reading.high_c, 3),
        )
        self.runs[number][place] = band.run_inside(reading.after_s + MINUTE_S / 2.0)

    def outcome(self) -> Outcome:
        return Outcome(self.states, self.measured_c, self.interrupted, self.runs)


def _followed_bands(
    forecast: StoredForecast, minutes: _Minutes, course: MinuteCourse
) -> list[FollowedBand | None]:
    """Bands of each channel next to what was measured; None where an earlier release kept none."""
    content = forecast.issued.content
    if not content.band_times_s:
        return [None] * len(content.channels)
    first = _first_minute(forecast, minutes)
    rows = slice(first, first + course.time_s.size)
    bands_c = _bands_at(content, course.time_s + MINUTE_S / 2.0)
    return [
        FollowedBand(course, minutes.means[name][rows], bands_c[k])
        for k, name in enumerate(content.channels)
    ]


def _bands_at(content: IssuedContent, at_s: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Both bands of each channel at some times, (n, 4)."""
    bands_c = all_degrees(content.bands)
    return [
        band_at(content.band_times_s, bands_c[:, k], at_s) for k in range(len(content.channels))
    ]


def _first_minute(forecast: StoredForecast, minutes: _Minutes) -> int:
    """Row of the first whole minute since a forecast was made."""
    return -(-(forecast.issued.time_us - minutes.start_us) // MINUTE_US)


def _set(states: list[PointState], places: Iterable[int], state: PointState) -> None:
    for place in places:
        states[place] = state


def _course(forecast: StoredForecast, minutes: _Minutes) -> MinuteCourse:
    issued = forecast.issued
    first = _first_minute(forecast, minutes)
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


def _scores_of(before: StoredForecast, after: Outcome) -> Iterable[Score]:
    """What was waiting before, and is not any more."""
    content = before.issued.content
    for number, lead_s in enumerate(content.lead_times_s):
        pairs = zip(before.outcome.states[number], after.states[number], strict=True)
        for k, (was, state) in enumerate(pairs):
            if was != "waiting" or state == "waiting":
                continue
            inside = left_inside = None
            if (interrupted := after.interrupted_at(number, k)) is not None:
                left_inside = interrupted.is_inside
            if state not in SET_ASIDE:
                low, *_, high = (degrees(one) for one in content.quantiles[number][k])
                value = after.measured_c[number][k]
                if low is not None and high is not None and value is not None:
                    inside = low <= value <= high
            yield Score(lead_s, content.high_risk[number], state, inside, left_inside)
