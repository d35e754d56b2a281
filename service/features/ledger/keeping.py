"""Which forecasts are kept to be compared with what comes, and what is kept of each."""

import math
import weakref
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final, TypedDict

import numpy as np

from adapters.protocol import Clock
from adapters.samples import PlannedProfile
from service.features.ledger.documents import Risk
from service.features.ledger.record import Kind, Record, nearest_leads_s
from service.live.asset import AssetRuntime
from service.live.estimate import EstimatedState
from service.live.issues import LiveIssue
from service.live.profiles import StepAhead, operating_profile
from service.store.forecast_records import IssuedContent, IssuedForecast, Reason, hundredths
from twin_core.forecasting import Forecast
from twin_core.naive import NaiveForecasts
from twin_core.operating_points import STANDING_RPM
from twin_core.simulation import OperatingProfile
from twin_core.verification import LEAD_TIMES_S, kept_rows
from twin_core.windows import MEASURED_TOLERANCE, LowRiskRegion

#: Process seconds after which a forecast is kept in any case.
KEPT_EVERY_S = 600.0
_NAIVE_ROW_S = 60.0
_STEPS_MAX = 200
#: By so much a band that is kept may depart from the forecast's own, or by this part of its width.
_BAND_K, _BAND_PART = 0.05, 0.01
#: Simple forecasts, as the twin's core and as the ledger call them.
NAIVE_NAMES = {"persistence": "persistence", "static_linear": "linear", "arx": "arx"}

PlanStep = tuple[int, float, float]
"""A step of a plan under way: how many are left with it, its speed and its load."""


class KeptLedger(TypedDict):
    """Which live forecast was kept last: its time, model version and step of the plan."""

    time_us: int
    version: int
    step: list[float] | None


class LedgerRule:
    """Says which live forecasts of an asset are kept.

    The first of each step of the controller's plan, the first of each model version, and one every
    ten minutes. None of a machine that stands and will stand: that it cools is easy to forecast,
    and thousands of such forecasts would hide the others.
    """

    def __init__(self) -> None:
        self._time_us: int | None = None
        self._version: int | None = None
        self._step: PlanStep | None = None

    def reason(self, issue: LiveIssue) -> Reason | None:
        """Say why a forecast is to be kept; None where it is not. It then counts as kept."""
        if all(abs(step.speed_rpm) < STANDING_RPM for step in issue.steps):
            return None
        time_us, version = issue.state.time_us, issue.state.active.version
        step = None if issue.plan is None else _under_way(issue.plan, time_us)
        found: Reason | None = None
        if self._version is not None and version != self._version:
            found = "model"
        elif step is not None and step != self._step:
            found = "step"
        elif (
            self._time_us is None
            # A clock that was set back by more than that begins again.
            or abs(time_us - self._time_us) >= KEPT_EVERY_S * 1e6
        ):
            found = "period"
        if found is not None:
            self._time_us, self._version, self._step = time_us, version, step
        return found

    def to_dict(self) -> KeptLedger | None:
        """Return what the next start must know, as plain JSON types; None before the first."""
        if self._time_us is None or self._version is None:
            return None
        step = None if self._step is None else list(self._step)
        return {"time_us": self._time_us, "version": self._version, "step": step}

    def restore(self, kept: KeptLedger) -> None:
        """Take up what `to_dict` gave; what does not fit is left out."""
        try:
            step = kept.get("step")
            known = None if step is None else (int(step[0]), float(step[1]), float(step[2]))
            self._time_us, self._version = int(kept["time_us"]), int(kept["version"])
            self._step = known
        except (KeyError, TypeError, ValueError, IndexError):
            return


class KeptForecastsOf:
    """Follows the live forecasts of an asset, and hands on those that are kept.

    ``keep`` takes them.
    """

    name: Final = "ledger"

    def __init__(
        self, asset: AssetRuntime, clock: Clock, keep: Callable[[IssuedForecast], None]
    ) -> None:
        # The asset has it: a circle of the two would outlive them.
        self._asset: AssetRuntime = weakref.proxy(asset)
        self._clock, self._keep = clock, keep
        self._rule = LedgerRule()
        self._high_risk: dict[int, bool] = {}
        self._records: Mapping[Kind, Record] = {}
        #: When its record was read, process time; and whether an alarm has asked for it since.
        self.read_us: int | None = None
        self.is_asked = False

    @property
    def asset(self) -> str:
        """Id of the asset."""
        return self._asset.id

    def record(self, channel: str, lead_time_s: float | None) -> str:
        """Say how forecasts of a channel have done at this lead time and risk."""
        self.is_asked = True
        for lead_s in nearest_leads_s(lead_time_s):
            risk: Risk = "high" if self._high_risk.get(lead_s, False) else "low"
            found = self._records.get((channel, lead_s, risk))
            if found is not None:
                return found.text(lead_s, risk)
        return ""

    def note_records(self, records: Mapping[Kind, Record], now_us: int) -> None:
        """Take what was read of them."""
        self._records, self.read_us, self.is_asked = records, now_us, False

    def issued(self, issue: LiveIssue) -> None:
        """Keep a forecast where it is one that is compared with what comes."""
        region = self._asset.settings.low_risk.region
        high_risk = _high_risk(issue.steps, LEAD_TIMES_S, region)
        self._high_risk = dict(zip(LEAD_TIMES_S, high_risk, strict=True))
        reason = self._rule.reason(issue)
        if reason is None:
            return
        asset, at_us = self._asset, self._clock.now_us()
        readings_c = {
            name: asset.readings.good_value(name, at_us)
            for name in issue.result.sensors
            if name in asset.facts
        }
        issued = issued_forecast(asset.id, issue, reason, region, asset.facts, readings_c)
        if issued is not None:
            self._keep(issued)

    def to_dict(self) -> KeptLedger | None:
        """Return what the next start must know; None before the first."""
        return self._rule.to_dict()

    def restore(self, kept: KeptLedger) -> None:
        """Take up what `to_dict` gave; what does not fit is left out."""
        self._rule.restore(kept)


def _under_way(plan: PlannedProfile, now_us: int) -> PlanStep | None:
    elapsed_s = (now_us - plan.time_us) / 1e6
    for number, step in enumerate(plan.steps):
        if step.duration_s > elapsed_s:
            return len(plan.steps) - number, float(step.speed_rpm), float(step.load_n)
        elapsed_s -= max(step.duration_s, 0.0)
    return None


def issued_forecast(
    asset: str,
    issue: LiveIssue,
    reason: Reason,
    region: LowRiskRegion,
    measured: Collection[str],
    readings_c: Mapping[str, float | None],
) -> IssuedForecast | None:
    """Take from a forecast what is kept of it; None where no lead time lies within it.

    Parameters
    ----------
    asset, issue, reason
        Whose forecast, and why it is kept.
    region
        The low-risk region.
    measured
        Channels of the asset: only what is measured can be compared with a forecast.
    readings_c
        What the sensors say now; None or absent where that is not good.
    """
    state, result = issue.state, issue.result
    leads = [lead for lead in LEAD_TIMES_S if lead <= result.time_s[-1] + 1e-3]
    channels = [name for name in result.sensors if name in measured]
    if not leads or not channels:
        return None
    steps = _merged(issue.steps)
    quantiles = np.array(
        [
            [np.interp(leads, result.time_s, row) for row in result.quantile(name)]
            for name in channels
        ],
        np.float64,
    )
    content = IssuedContent(
        steps=[_kept_step(step) for step in steps],
        planned=issue.plan is not None,
        labels=list(result.labels),
        channels=channels,
        lead_times_s=leads,
        high_risk=_high_risk(steps, leads, region),
        quantiles=[
            [[hundredths(value) for value in row] for row in of_lead]
            for of_lead in quantiles.transpose(2, 0, 1).tolist()
        ],
        naive=_naive(state, issue.steps, leads, channels, readings_c),
        **_bands(result, channels, leads[-1]),
    )
    return IssuedForecast(asset, state.time_us, state.active.version, reason, content)


class _Bands(TypedDict):
    band_times_s: list[float]
    bands: list[list[list[int | None]]]


def _bands(result: Forecast, channels: Sequence[str], until_s: float) -> _Bands:
    """Both bands up to a time, at as few times as they need."""
    rows = slice(0, int(np.searchsorted(result.time_s, until_s)) + 1)
    edges_c = np.array(
        [[*result.quantile(name)[[0, -1]], *result.whole_run(name)] for name in channels]
    )[..., rows]
    time_s = result.time_s[rows]
    width_k = np.mean(edges_c[:, 1] - edges_c[:, 0], axis=-1)
    within_k = np.repeat(np.maximum(_BAND_K, _BAND_PART * width_k), edges_c.shape[1])
    kept = kept_rows(time_s, edges_c.reshape(-1, time_s.size), within_k)
    return _Bands(
        band_times_s=[round(float(one), 1) for one in time_s[kept]],
        bands=[
            [[hundredths(value) for value in of_channel] for of_channel in of_time]
            for of_time in edges_c[..., kept].transpose(2, 0, 1).tolist()
        ],
    )


def _merged(steps: Sequence[StepAhead]) -> list[StepAhead]:
    """Steps without those that only go on as the one before, and not more than are kept."""
    merged: list[StepAhead] = []
    for step in steps:
        if merged and _level(merged[-1]) == _level(step):
            step = StepAhead(merged.pop().duration_s + step.duration_s, *_level(step))
        merged.append(step)
    return merged[:_STEPS_MAX]


def _level(step: StepAhead) -> tuple[float, float, float]:
    return step.speed_rpm, step.load_n, step.ambient_c


def _kept_step(step: StepAhead) -> tuple[float, float, float, float]:
    return (
        round(step.duration_s, 3),
        round(step.speed_rpm, 3),
        round(step.load_n, 3),
        round(step.ambient_c, 3),
    )


def _high_risk(
    steps: Sequence[StepAhead], leads: Sequence[int], region: LowRiskRegion
) -> list[bool]:
    """Whether what lies before each lead time leaves the low-risk region."""
    begin_s, leaves_s = 0.0, math.inf
    for step in steps:
        if not bool(region.contains(step.speed_rpm, step.load_n, MEASURED_TOLERANCE)):
            leaves_s = begin_s
            break
        begin_s += step.duration_s
    return [lead > leaves_s for lead in leads]


def _naive(
    state: EstimatedState,
    steps: Sequence[StepAhead],
    leads: Sequence[int],
    channels: Sequence[str],
    readings_c: Mapping[str, float | None],
) -> dict[str, list[list[int | None]]]:
    """What the simple forecasts say at the lead times, issued at the same moment."""
    found: dict[str, list[list[int | None]]] = {
        "persistence": [[hundredths(readings_c.get(name)) for name in channels] for _ in leads]
    }
    naive = state.active.naive
    if naive is not None:
        profile = operating_profile(steps, _NAIVE_ROW_S)
        rows = np.searchsorted(profile.time_s, np.array(leads) + 1e-3, side="right") - 1
        series = _series(naive, profile, readings_c)
        for kind, name in NAIVE_NAMES.items():
            if kind != "persistence":
                of_kind = series[kind]
                found[name] = [
                    [
                        hundredths(float(of_kind[channel][row])) if channel in of_kind else None
                        for channel in channels
                    ]
                    for row in rows
                ]
    return found


def _series(
    naive: NaiveForecasts, profile: OperatingProfile, readings_c: Mapping[str, float | None]
) -> Mapping[str, Mapping[str, np.ndarray[tuple[int], np.dtype[np.float64]]]]:
    known = {name: readings_c.get(name) for name in naive.sensors}
    last_c = {name: math.nan if value is None else value for name, value in known.items()}
    return naive.forecast(profile, last_c)
