"""Runs of the study ``alarms``: the service's own rules over a bench, in process time."""

import contextlib
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from adapters.samples import Quality, Sample
from adapters.virtual_bench import (
    BenchParameters,
    MeasuredRun,
    Scenario,
    find_scenario,
    measure,
    scenario_profile,
    simulate,
)
from bearing_twin_laboratory.studies.drift_runs import (
    BEARING,
    RINGS,
    VERSION_MIN,
    minute_rows,
    scenario_of,
)
from service.alarms import AlarmBook
from service.live.estimate import LiveEstimate, RunningModel
from service.live.presentation import limit_crossings
from service.live.readings import Readings
from service.live.reference import advance_together
from service.live.watch import AlarmWatch
from service.site.asset_section import AssetSection
from service.site.wiring import ChannelFacts
from service.store import JournalFilter, Outbox, Store
from twin_core.bearings import bearing
from twin_core.forecasting import Forecast, forecast
from twin_core.identification import (
    FitSettings,
    IdentificationData,
    IdentificationWindow,
    Posterior,
    identify,
)
from twin_core.models import build_model
from twin_core.simulation import OperatingProfile
from twin_core.windows import LowRiskRegion, find_windows

ASSET = "bench"
CHANNELS = ("speed_rpm", "load_n", "ambient_c", *RINGS)
CONTROLS = ("unchanged, other plans", "unchanged")
LONG_CASES = (*CONTROLS, "cooling-loss", "grease-degradation")
SHORT_CASES = ("overload", "sensor-break")
REGION = LowRiskRegion(4300.0, 3400.0)
IDENTIFIED_H = 36.0
"""The model is that of the twelve hours before; the alarms are watched from then on."""

MARGIN_WARNING_K, MARGIN_ALARM_K = 5.0, 15.0
"""Limits, absolute and above ambient: so much over the hottest of the hours before."""

_ROW_S = 10.0
_LONG_STEP_S, _SHORT_STEP_S = 60.0, 10.0
_FORECAST_EVERY_S = {_LONG_STEP_S: 3600.0, _SHORT_STEP_S: 120.0}
_FORECAST_ROW_S, _HORIZON_S, _MEMBERS = 300.0, 4 * 3600.0, 100
_BROKEN_C = -3276.8
_EPOCH_US = 1_700_000_000_000_000


@dataclass(frozen=True, slots=True)
class Call:
    """One time that an alarm called for an operator: hours on the bench's clock."""

    kind: str
    channel: str
    level: str
    time_h: float


@dataclass(frozen=True, slots=True)
class Fault:
    """What truly happens, and when: the fault's channel, or empty for the whole machine."""

    channel: str
    onset_h: float


@dataclass(frozen=True, slots=True)
class AlarmRun:
    """One bench in one case.

    - ``hours``: how long the alarms were watched.
    - ``calls``: alarms that called for the operator.
    - ``faults``: what truly happened, in order.
    """

    case: str
    seed: int
    hours: float
    calls: tuple[Call, ...]
    faults: tuple[Fault, ...]


class _Clock:
    rate = 1.0

    def __init__(self, begin_us: int) -> None:
        self.us = begin_us

    def now_us(self) -> int:
        return self.us

    async def sleep(self, process_seconds: float) -> None:
        self.us += round(1e6 * process_seconds)


def examine(seed: int) -> list[AlarmRun]:
    """Run one bench through all cases."""
    bench = BenchParameters.random(seed, BEARING)
    runs = []
    known: tuple[Posterior, Mapping[str, float]] | None = None
    for case in LONG_CASES:
        scenario = scenario_of(case, seed)
        seen = _measured(scenario, bench, seed)
        posterior, hottest = _commissioned(seen)
        known = known or (posterior, hottest)
        onset_h = min((change.start_s / 3600.0 for change in scenario.changes), default=None)
        faults = () if onset_h is None else (Fault("", onset_h),)
        runs.append(_watched(case, seed, seen, posterior, hottest, faults, IDENTIFIED_H))
    if known is None:
        raise RuntimeError("no case gave a model")
    for case in SHORT_CASES:
        scenario = find_scenario(case)
        seen = _measured(scenario, bench, seed)
        broken = [Fault(one.channel, one.start_s / 3600.0) for one in scenario.faults]
        changed = [Fault("", change.start_s / 3600.0) for change in scenario.changes]
        runs.append(_watched(case, seed, _break(scenario, seen), *known, (*broken, *changed), 0.0))
    return runs


def _measured(scenario: Scenario, bench: BenchParameters, seed: int) -> MeasuredRun:
    profile = scenario_profile(scenario, bench, seed, _ROW_S)
    return measure(profile, simulate(profile, bench, max_step_s=5.0), seed)


def _break(scenario: Scenario, seen: MeasuredRun) -> MeasuredRun:
    """Put what a broken sensor shows where the scenario breaks it."""
    shown: dict[str, NDArray[np.float64]] = {}
    for fault in scenario.faults:
        values = shown.setdefault(fault.channel, getattr(seen, fault.channel).copy())
        gone = (seen.time_s >= fault.start_s) & (seen.time_s < fault.start_s + fault.duration_s)
        values[gone] = _BROKEN_C
    return replace(seen, **shown)


def _commissioned(seen: MeasuredRun) -> tuple[Posterior, dict[str, float]]:
    """Identify a model before the watch begins, and note how hot it was."""
    minutes = minute_rows(seen)
    end = round(60 * IDENTIFIED_H)
    data = minutes.take(slice(end - VERSION_MIN, end))
    windows = tuple(
        IdentificationWindow(
            data.between(window.start_s, window.end_s),
            at_rest=window.at_rest,
            revolutions=float(minutes.speed_rpm[minutes.time_s < window.start_s].sum()),
        )
        for window in find_windows(data, REGION)
    )
    model = build_model(bearing=bearing(BEARING))
    posterior = identify(model, IdentificationData(windows), FitSettings(method="refine")).posterior
    before = seen.time_s < 3600.0 * IDENTIFIED_H
    hottest = {name: float(getattr(seen, name)[before].max()) for name in RINGS} | {
        f"{name} above ambient": float((getattr(seen, name) - seen.ambient_c)[before].max())
        for name in RINGS
    }
    return posterior, hottest


def _section(hottest: Mapping[str, float]) -> AssetSection:
    def pairs(suffix: str) -> dict[str, dict[str, float]]:
        return {
            name: {
                "warning": hottest[name + suffix] + MARGIN_WARNING_K,
                "alarm": hottest[name + suffix] + MARGIN_ALARM_K,
            }
            for name in RINGS
        }

    return AssetSection.model_validate(
        {
            "id": ASSET,
            "bearing": BEARING,
            "low_risk": {"speed_rpm_max": REGION.speed_rpm_max, "load_n_max": REGION.load_n_max},
            "limits": pairs(""),
            "channels": {name: {"source": "push"} for name in CHANNELS},
            "alarms": {"above_ambient": {"limits": pairs(" above ambient")}},
        }
    )


def _watched(
    case: str,
    seed: int,
    seen: MeasuredRun,
    posterior: Posterior,
    hottest: Mapping[str, float],
    faults: tuple[Fault, ...],
    from_h: float,
) -> AlarmRun:
    """Watch a run of a bench."""
    step_s = _LONG_STEP_S if case in LONG_CASES else _SHORT_STEP_S
    calls = watched(
        _section(hottest),
        RunningModel(1, build_model(bearing=bearing(BEARING)), posterior, _EPOCH_US),
        _samples(seen, from_h, step_s),
        step_s,
        _EPOCH_US + round(3.6e9 * from_h),
        _FORECAST_EVERY_S[step_s],
    )
    return AlarmRun(case, seed, float(seen.time_s[-1]) / 3600.0 - from_h, calls, faults)


def watched(
    section: AssetSection,
    running: RunningModel,
    steps: Iterable[tuple[int, list[Sample]]],
    step_s: float,
    begin_us: int,
    forecast_every_s: float,
) -> tuple[Call, ...]:
    """Watch a machine with the service's own estimate, rules and alarm book.

    ``steps``: what arrives during each step of ``step_s``, and when the step ends. Returns what
    called for an operator; hours count from `_EPOCH_US`.
    """
    clock = _Clock(begin_us)
    names = tuple(section.channels)
    estimate = LiveEstimate(running)
    readings = Readings(section.id, dict.fromkeys(names, 4 * step_s), clock.us)
    facts = {name: ChannelFacts("bench", 4 * step_s) for name in names}
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        store = stack.enter_context(Store.open("", folder))
        outbox = stack.enter_context(Outbox.open(folder, store))
        book = AlarmBook(outbox, clock, lambda alarm: None)
        watch = AlarmWatch(section, facts, readings, estimate, book)
        forecast_us = 0
        for time_us, samples in steps:
            clock.us = time_us
            readings.add(samples)
            means = readings.take_means()
            estimate.step(time_us, means)
            advance_together([watch.follow(time_us)])
            watch.step(time_us, means, trusted=True)
            if estimate.started and time_us - forecast_us >= 1e6 * forecast_every_s:
                forecast_us = time_us
                watch.forecast(time_us, limit_crossings(_held(estimate), section.limits))
        outbox.flush(30.0)
        lines = store.alarms.journal(JournalFilter(events=False), limit=100_000).items
    return tuple(
        Call(line.kind, line.channel, line.level, (line.time_us - _EPOCH_US) / 3.6e9)
        for line in lines[::-1]
        if line.to_state == "UNACK"
    )


def _samples(seen: MeasuredRun, from_h: float, step_s: float) -> Iterator[tuple[int, list[Sample]]]:
    """What arrives during each step, and when the step ends."""
    per_step = round(step_s / _ROW_S)
    first = int(np.searchsorted(seen.time_s, 3600.0 * from_h))
    value_of: dict[str, Callable[[int], float]] = {
        name: getattr(seen, name).item for name in CHANNELS
    }
    for start in range(first, seen.time_s.size - per_step + 1, per_step):
        samples = []
        for row in range(start, start + per_step):
            row_us = _EPOCH_US + round(1e6 * float(seen.time_s[row]))
            for name in CHANNELS:
                value = value_of[name](row)
                good = value != _BROKEN_C
                quality = Quality.GOOD if good else Quality.SENSOR_FAILURE
                samples.append(Sample(ASSET, name, row_us, value, quality, row_us))
        yield row_us, samples


def _held(estimate: LiveEstimate) -> Forecast:
    """The forecast with the present point held, as the service makes it without a plan."""
    state = estimate.state()
    if state is None:
        raise RuntimeError("a started estimate has a state")
    active, point = state.active, state.point
    time_s = np.arange(0.0, _HORIZON_S + 1.0, _FORECAST_ROW_S)
    profile = OperatingProfile(
        time_s,
        np.full(time_s.size, point.speed_rpm),
        np.full(time_s.size, point.load_n),
        np.full(time_s.size, point.ambient_c),
    )
    # The observer's own temperatures, not those bounded by the surroundings.
    machine = replace(state.machine, temperatures_c=estimate.observer.temperatures_c)
    return forecast(active.model, active.posterior, machine, profile, members=_MEMBERS, seed=0)
