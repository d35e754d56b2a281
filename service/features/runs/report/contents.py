"""What the report of a run says: taken from the store alone, the same for the same data."""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from service.clock import MICROSECONDS, MINUTE_US
from service.domain.channels import AMBIENT, LOAD, SPEED, is_temperature
from service.features.runs.runs import Annotation, Run, Runs
from service.site.asset_section import AssetSection
from service.store import Activation, AlarmTransition, JournalFilter, Rollup, Store
from service.store.forecast_records import SET_ASIDE, ForecastRecords, StoredForecast, all_degrees
from twin_core.verification import LEAD_TIMES_S, ForecastScores, verify

FloatArray = NDArray[np.float64]

_MOST_POINTS: Final = 720
_BUCKETS_MIN: Final = (1, 2, 5, 10, 20, 30, 60, 120, 360, 720, 1440)
_MOST_LINES: Final = 5000
#: The lead time that is drawn, where there is one; else the next shorter one.
_DRAWN_S: Final = 3600


@dataclass(frozen=True, slots=True)
class Curve:
    """A channel over the run, by buckets.

    - ``time_s``: (n,) middles of the buckets, since the start of the run.
    - ``mean``, ``low``, ``high``: (n,) of the good values, in the channel's unit; NaN without any.
    - ``peak``, ``peak_us``: the highest value and the start of its bucket; None without any good
      value.
    - ``good_share``: share of the run's buckets with a good value, 0 to 1.
    - ``longest_gap_s``: longest time without any.
    """

    time_s: FloatArray
    mean: FloatArray
    low: FloatArray
    high: FloatArray
    peak: float | None
    peak_us: int | None
    good_share: float
    longest_gap_s: int


@dataclass(frozen=True, slots=True)
class AlarmLine:
    """An alarm of the run: process times of what happened to it, None where it did not."""

    message: str
    kind: str
    priority: int | None
    raised_us: int | None
    acknowledged_us: int | None
    acknowledged_by: str
    returned_us: int | None
    peak: float | None


@dataclass(frozen=True, slots=True)
class ForecastLine:
    """How good the forecasts of one channel and lead time were whose times lie in the run."""

    channel: str
    lead_time_s: int
    scores: ForecastScores
    set_aside: int


@dataclass(frozen=True, slots=True)
class Ahead:
    """Forecasts of one lead time: (n,) times since the start, (n, 5) quantiles of each channel."""

    lead_time_s: int
    time_s: FloatArray
    quantiles_c: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True)
class Report:
    """Everything that a report says.

    - ``end_us``: of the run; while it goes on, of its data.
    - ``bucket_s``: length of the buckets of the curves.
    - ``curves``: by channel; estimates of the twin are ``<channel>.twin``.
    - ``forecasts``, ``forecasts_made``: scores, and how many forecasts they are of.
    - ``models``: the version that was active at the start, and each that became active later.
    - ``time_zone``: of the local times next to UTC on paper.
    """

    asset: AssetSection
    run: Run
    end_us: int
    bucket_s: int
    curves: Mapping[str, Curve]
    alarms: Sequence[AlarmLine]
    forecasts: Sequence[ForecastLine]
    forecasts_made: int
    ahead: Ahead | None
    models: Sequence[Activation]
    annotations: Sequence[Annotation]
    time_zone: str = "UTC"

    @property
    def length_s(self) -> float:
        """Length of the run."""
        return (self.end_us - self.run.start_us) / MICROSECONDS

    @property
    def temperatures(self) -> list[str]:
        """Measured temperatures: those with limits first, the surroundings last."""
        names = [name for name in self.curves if is_temperature(name)]
        names.sort(key=lambda name: (name not in self.asset.limits, _natural(name)))
        return names + [AMBIENT] * (AMBIENT in self.curves)


def contents(
    store: Store, asset: AssetSection, run: Run, now_us: int, time_zone: str = "UTC"
) -> Report:
    """Gather what the report of a run says.

    ``now_us``: process time, for a run that goes on; ``time_zone``: of the local times next to UTC
    on paper.
    """
    end_us = now_us if run.end_us is None else run.end_us
    minutes = (end_us - run.start_us) / MINUTE_US
    bucket_min = next((one for one in _BUCKETS_MIN if minutes <= one * _MOST_POINTS), None)
    bucket_us = (bucket_min or -(-int(minutes) // _MOST_POINTS // 1440 + 1) * 1440) * MINUTE_US
    names = [
        name
        for name in store.samples.channels(asset.id)
        if is_temperature(name.partition(".")[0]) or name in (SPEED, LOAD, AMBIENT)
    ]
    most = len(names) * (_MOST_POINTS + 2)
    begin_us = run.start_us - run.start_us % bucket_us
    rows = store.history.read(asset.id, names, begin_us, end_us, bucket_us, most)
    if run.end_us is None and rows:  # the same until there are other data
        end_us = min(end_us, max(row.time_us for row in rows) + bucket_us)
    by_channel: defaultdict[str, list[Rollup]] = defaultdict(list)
    for row in rows:
        by_channel[row.channel].append(row)
    count = max(-(-(end_us - begin_us) // bucket_us), 1)
    curves = {
        name: _curve(by_channel[name], run.start_us, begin_us, count, bucket_us)
        for name in names
        if name in by_channel
    }
    longest_us = max(LEAD_TIMES_S) * MICROSECONDS
    made = store.part(ForecastRecords).since(asset.id, run.start_us - longest_us, None, end_us)
    forecasts, used = _forecasts(made, run.start_us, end_us)
    return Report(
        asset=asset,
        run=run,
        end_us=end_us,
        bucket_s=bucket_us // MICROSECONDS,
        curves=curves,
        alarms=_alarms(store, asset.id, run.start_us, end_us),
        forecasts=forecasts,
        forecasts_made=used,
        ahead=_ahead(made, run.start_us, end_us),
        models=_models(store.models.activations(asset.id), run.start_us, end_us),
        annotations=store.part(Runs).annotations(asset.id, run.start_us, end_us),
        time_zone=time_zone,
    )


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort key: node 2 comes before node 10."""
    parts = re.split(r"(\d+)", name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _curve(rows: Sequence[Rollup], start_us: int, begin_us: int, count: int, step: int) -> Curve:
    columns = np.full((3, count), np.nan)
    for row in rows:
        place = (row.time_us - begin_us) // step
        if row.mean is not None and row.min is not None and row.max is not None and place < count:
            columns[:, place] = row.mean, row.min, row.max
    mean, low, high = columns
    known = np.flatnonzero(~np.isnan(mean))
    best = int(known[np.argmax(high[known])]) if known.size else None
    edges = np.concatenate(([-1], known, [count]))
    middles_us = begin_us - start_us + (np.arange(count) + 0.5) * step
    return Curve(
        time_s=middles_us / MICROSECONDS,
        mean=mean,
        low=low,
        high=high,
        peak=None if best is None else float(high[best]),
        peak_us=None if best is None else begin_us + best * step,
        good_share=known.size / count,
        longest_gap_s=int(np.max(np.diff(edges)) - 1) * step // MICROSECONDS,
    )


def _alarms(store: Store, asset: str, start_us: int, end_us: int) -> list[AlarmLine]:
    """The alarms to which something happened, in the order in which it did."""
    wanted = JournalFilter(asset, start_us=start_us, end_us=end_us + 1, events=False)
    page = store.alarms.journal(wanted, _MOST_LINES)
    of_alarm: defaultdict[str | None, list[AlarmTransition]] = defaultdict(list)
    for line in reversed(page.items):
        of_alarm[line.alarm_id].append(line)
    found = []
    for lines in of_alarm.values():
        last = lines[-1]
        peaks = [line.peak_value for line in lines if line.peak_value is not None]
        acknowledged = _first(lines, "acknowledge")
        found.append(
            AlarmLine(
                message=last.message or last.kind,
                kind=last.kind,
                priority=last.priority,
                raised_us=_time(_first(lines, "raise")),
                acknowledged_us=_time(acknowledged),
                acknowledged_by=acknowledged.who if acknowledged else "",
                returned_us=_time(_first(lines[::-1], "return to normal")),
                peak=max(peaks, default=None),
            )
        )
    return found


def _first(lines: Sequence[AlarmTransition], event: str) -> AlarmTransition | None:
    return next((line for line in lines if line.event == event), None)


def _time(line: AlarmTransition | None) -> int | None:
    return None if line is None else line.time_us


def _forecasts(
    made: Sequence[StoredForecast], start_us: int, end_us: int
) -> tuple[list[ForecastLine], int]:
    """Score the readings whose times lie in the run, and count the forecasts that have any."""
    quantiles: defaultdict[tuple[str, int], list[list[int | None]]] = defaultdict(list)
    measured: defaultdict[tuple[str, int], list[float | None]] = defaultdict(list)
    aside: defaultdict[tuple[str, int], int] = defaultdict(int)
    used = 0
    for one in made:
        content = one.issued.content
        counts = False
        for number, lead_s in enumerate(content.lead_times_s):
            if not start_us <= one.issued.time_us + lead_s * MICROSECONDS <= end_us:
                continue
            counts = True
            for place, channel in enumerate(content.channels):
                key = channel, lead_s
                state = one.outcome.states[number][place]
                aside[key] += state in SET_ASIDE
                if state == "scored" and None not in content.quantiles[number][place]:
                    quantiles[key].append(content.quantiles[number][place])
                    measured[key].append(one.outcome.measured_c[number][place])
        used += counts
    lines = [
        ForecastLine(
            *key,
            verify(all_degrees(quantiles[key]).reshape(-1, 5), np.array(measured[key], np.float64)),
            aside[key],
        )
        for key in sorted(aside)
    ]
    return lines, used


def _ahead(made: Sequence[StoredForecast], start_us: int, end_us: int) -> Ahead | None:
    """The forecasts of the lead time that is drawn: its bands where they were for the run."""
    leads = sorted({lead for one in made for lead in one.issued.content.lead_times_s})
    fitting = [
        lead for lead in leads if lead <= _DRAWN_S and lead * MICROSECONDS < end_us - start_us
    ]
    if not fitting:
        return None
    lead_s = fitting[-1]
    found: dict[int, dict[str, list[int | None]]] = {}
    for one in made:
        content = one.issued.content
        at_us = one.issued.time_us + lead_s * MICROSECONDS
        if lead_s in content.lead_times_s and start_us <= at_us <= end_us:
            number = content.lead_times_s.index(lead_s)
            # Of several for the same moment, the one that was kept last.
            found[at_us] = dict(zip(content.channels, content.quantiles[number], strict=True))
    if not found:
        return None
    times_us = sorted(found)
    channels = sorted({channel for of in found.values() for channel in of})
    none: list[int | None] = [None] * 5
    return Ahead(
        lead_s,
        (np.array(times_us) - start_us) / MICROSECONDS,
        {
            channel: all_degrees([found[at].get(channel, none) for at in times_us])
            for channel in channels
        },
    )


def _models(all_of: Sequence[Activation], start_us: int, end_us: int) -> list[Activation]:
    before = [one for one in all_of if one.at_us <= start_us]
    return before[-1:] + [one for one in all_of if start_us < one.at_us <= end_us]
