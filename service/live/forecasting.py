"""The live forecast of one asset, and what-if forecasts from a state of it."""

import asyncio
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from adapters.protocol import Clock
from adapters.samples import PlannedProfile
from service.clock import rfc3339
from service.documents.forecasts import (
    QUANTILE_DECIMALS,
    ForecastDocument,
    LiveForecast,
    WhatIf,
    forecast_document,
)
from service.domain.channels import OPERATING_CHANNELS
from service.domain.requests import ProfileStep
from service.live import presentation
from service.live.estimate import EstimatedState, LiveEstimate
from service.live.issues import LiveIssue
from service.live.outlook import Outlook, StepOutlook, step_outlooks
from service.live.presentation import ForecastSummary
from service.live.profiles import StepAhead, held, operating_profile, planned
from service.live.readings import Readings, allowed_age_s
from service.live.reuse import Ensemble, is_like, keep_ensemble, renewal_phase, reuse
from service.site.asset_section import AssetSection, LimitsSection
from twin_core.forecasting import Forecast, forecast
from twin_core.forecasting.margins import heaviest_margin
from twin_core.forecasting.runaway import RunawayDistance
from twin_core.profiles import Point
from twin_core.simulation import OperatingProfile

FORECAST_ROW_S = 60.0
HORIZON_S = 4 * 3600.0
MEMBERS = 200
#: So long somebody who has asked for a forecast goes on looking at it; process s, and at least so
#: many wall s.
LOOKED_AT_FOR_S, LOOKED_AT_FOR_WALL_S = 300.0, 10.0
_PLAN_MAX_AGE_S = 30.0


class _Live(NamedTuple):
    """A live forecast, what tags and verdicts need of it, and the ensemble of its intervals.

    `result` is what is shown, for those who follow the forecasts.
    """

    result: Forecast
    margin: RunawayDistance | None
    summary: ForecastSummary
    steps: tuple[StepOutlook, ...]
    ensemble: Ensemble | None
    intervals_us: int


class _Reuse(NamedTuple):
    """What a forecast with the intervals of an earlier ensemble is made of."""

    kept: Ensemble
    state: EstimatedState
    profile: OperatingProfile
    limits: Mapping[str, LimitsSection]


class _Latest(NamedTuple):
    """The latest live forecast as far as it is shown.

    One with earlier intervals is made again, to the bit, for who asks: of hundreds of machines
    hardly one is looked at, and each would hold 70 kB more.
    """

    result: Forecast | _Reuse
    margin: RunawayDistance | None
    summary: ForecastSummary
    steps: Sequence[StepAhead]
    model_version: int
    missing: Sequence[str]
    intervals_us: int
    planned: bool


class Forecasting:
    """Forecasts along the controller's plan, or with the present point held.

    An ensemble is made where a plan lies ahead, a limit is near, the operation is not known or
    somebody looks; else the intervals of the last one are used again, see `service.live.reuse`.

    Parameters
    ----------
    settings : AssetSection
        The asset's configuration.
    estimate : LiveEstimate
        Where forecasts start from.
    readings : Readings
        The present point before there is an estimate.
    clock : Clock
        Process time.
    executor : concurrent.futures.Executor
        Where forecasts are computed.

    Attributes
    ----------
    plan : PlannedProfile or None
        What the controller was last heard to plan.
    summary : ForecastSummary or None
        What tags show of it, and when it exceeds which limit.
    outlook : Outlook or None
        The same for every step of it; None before the first.
    """

    def __init__(
        self,
        settings: AssetSection,
        estimate: LiveEstimate,
        readings: Readings,
        clock: Clock,
        executor: Executor,
    ) -> None:
        self._limits: Mapping[str, LimitsSection] = settings.limits
        self._phase = renewal_phase(settings.id)
        self._estimate = estimate
        self._readings = readings
        self._clock = clock
        self._executor = executor
        self.plan: PlannedProfile | None = None
        self._latest: _Latest | None = None
        self._reused = False
        self.summary: ForecastSummary | None = None
        self.outlook: Outlook | None = None
        self._issue: LiveIssue | None = None
        self._ensemble: Ensemble | None = None
        self._looked_us: int | None = None
        # How often the clock was set: what was begun before has other times.
        self._times_set = 0

    def change_limits(self, limits: Mapping[str, LimitsSection]) -> None:
        """Set other limits; what was forecast of those before is gone."""
        self._limits = limits
        self._latest = self._ensemble = None
        self.summary = self.outlook = self._issue = None

    def take_issue(self) -> LiveIssue | None:
        """Give the latest forecast, once, to what follows it; None of an unknown operation."""
        issue, self._issue = self._issue, None
        return issue

    def clock_set(self, by_us: int) -> None:
        """Let forecast and plan be as old as before: the clock was set by so much."""
        if self.plan is not None:
            self.plan = replace(self.plan, time_us=self.plan.time_us + by_us)
        if self.summary is not None:
            self.summary = replace(self.summary, made_us=self.summary.made_us + by_us)
        if self.outlook is not None:
            self.outlook = replace(self.outlook, made_us=self.outlook.made_us + by_us)
        if self._latest is not None:
            self._latest = self._latest._replace(
                summary=replace(self._latest.summary, made_us=self._latest.summary.made_us + by_us),
                intervals_us=self._latest.intervals_us + by_us,
            )
        if self._looked_us is not None:
            self._looked_us += by_us
        self._times_set += 1

    def look(self) -> bool:
        """Record that somebody looks; returns whether the latest has intervals of earlier."""
        self._looked_us = self._clock.now_us()
        return self._reused

    @property
    def latest(self) -> LiveForecast | None:
        """The latest live forecast; None before the first.

        Made for who asks, which few do: it has tens of thousands of figures.
        """
        made = self._latest
        if made is None:
            return None
        result = made.result
        if isinstance(result, _Reuse):
            again = reuse(*result)
            if again is None:
                raise RuntimeError("a forecast was made with intervals that cannot be reused")
            result = _shown(again)
        return LiveForecast(
            **dict(_document(result, made.margin, made.summary, self._limits)),
            model_version=made.model_version,
            profile=presentation.steps_document(made.steps),
            missing=list(made.missing),
            made_at=rfc3339(made.summary.made_us),
            intervals_made_at=rfc3339(made.intervals_us),
            planned=made.planned,
        )

    @property
    def has_begun(self) -> bool:
        """Whether there is a state that a forecast can start from."""
        return self._estimate.started

    def age_s(self) -> float:
        """Process seconds since the state that the live forecast starts from; NaN before it."""
        made = self.summary
        return math.nan if made is None else (self._clock.now_us() - made.made_us) / 1e6

    def take_plan(self, plan: PlannedProfile) -> bool:
        """Follow a plan from now on; returns whether it is another one than before."""
        known, self.plan = self.plan, plan
        return known is None or _beyond_times(known) != _beyond_times(plan)

    async def make(self, missing: Sequence[str] = ()) -> bool:
        """Make a new live forecast; False when there is none.

        There is none when the plan is over and nothing lies ahead, or when the limits were changed
        or the clock was set meanwhile.

        Parameters
        ----------
        missing : sequence of str
            Operating channels without a usable value: no verdict follows from such a forecast.
        """
        state = self._estimate.state()
        if state is None:
            raise RuntimeError("the estimate has not started")
        made_us, version = state.time_us, state.active.version
        steps = self.steps_ahead(made_us)
        if not steps:
            return False
        profile = operating_profile(steps, FORECAST_ROW_S, state.point.inputs)
        has_plan = self._has_plan(made_us)
        alone = not (missing or has_plan)
        kept = self._ensemble if alone and not self._is_looked_at(made_us) else None
        loop, limits, times_set = asyncio.get_running_loop(), self._limits, self._times_set
        live = await loop.run_in_executor(
            self._executor, _make_live, state, steps, profile, limits, kept, alone, self._phase
        )
        if limits is not self._limits or times_set != self._times_set:
            return False
        self._ensemble, self._reused = live.ensemble, live.intervals_us != made_us
        summary = live.summary
        again = None if live.ensemble is not kept or kept is None else kept
        self._latest = _Latest(
            live.result if again is None else _Reuse(again, state, profile, limits),
            live.margin,
            summary,
            steps,
            version,
            missing,
            live.intervals_us,
            has_plan,
        )
        self.summary, self.outlook, self._issue = summary, None, None
        if not missing:
            plan = self.plan if has_plan else None
            self._issue = LiveIssue(state, steps, live.result, plan)
            self.outlook = Outlook(made_us, version, live.steps, summary.crossings)
        return True

    def steps_ahead(self, now_us: int) -> list[StepAhead]:
        """What the machine is going to do, as far as that is known."""
        point = self._estimate.point
        if point is None:
            speed_rpm, load_n, ambient_c, *inputs = (
                self._readings.usable_value(name, now_us) or 0.0
                for name in (
                    *OPERATING_CHANNELS,
                    *self._estimate.active.model.input_names,
                )
            )
            point = Point(speed_rpm, load_n, ambient_c, tuple(inputs))
        if self.plan is not None and self._has_plan(now_us):
            return planned(self.plan, now_us, point, HORIZON_S)
        return held(point, HORIZON_S)

    def _is_looked_at(self, now_us: int) -> bool:
        if self._looked_us is None:
            return False
        looking_s = max(LOOKED_AT_FOR_S, LOOKED_AT_FOR_WALL_S * self._clock.rate)
        return abs(now_us - self._looked_us) / 1e6 <= looking_s

    def _has_plan(self, now_us: int) -> bool:
        plan = self.plan
        if plan is None or not plan.steps:
            return False
        return (now_us - plan.time_us) / 1e6 <= allowed_age_s(_PLAN_MAX_AGE_S, self._clock.rate)


def _make_live(
    state: EstimatedState,
    steps: Sequence[StepAhead],
    profile: OperatingProfile,
    limits: Mapping[str, LimitsSection],
    kept: Ensemble | None,
    keeps: bool,
    phase: float,
) -> _Live:
    """Carry the kept ensemble on where that is right, else make one, and keep it if wanted."""
    result, margin, ensemble = None, None, kept
    if kept is not None and is_like(kept, state, profile, phase):
        result, margin = reuse(kept, state, profile, limits), kept.margin
    if result is None:
        (result, margin), ensemble = _make(state, profile), None
    summary = presentation.summarize(result, limits, state.time_us)
    outlooks = step_outlooks(result, steps, limits)
    intervals_us = state.time_us if ensemble is None else ensemble.state.time_us
    if ensemble is None and keeps:
        ensemble = keep_ensemble(result, margin, state, profile, limits)
    return _Live(_shown(result), margin, summary, outlooks, ensemble, intervals_us)


def _shown(result: Forecast) -> Forecast:
    """To the figures that are shown, in half the memory, and without the members."""
    return replace(
        result,
        quantiles=np.round(result.quantiles, QUANTILE_DECIMALS).astype(np.float32),
        members_c=np.empty((0, 0, 0)),
    )


def _make(
    state: EstimatedState, profile: OperatingProfile
) -> tuple[Forecast, RunawayDistance | None]:
    active = state.active
    of = active.model, active.posterior, state.machine, profile
    margin = heaviest_margin(*of) if active.posterior.identified else None
    return forecast(*of, members=MEMBERS), margin


def _document(
    result: Forecast,
    margin: RunawayDistance | None,
    summary: ForecastSummary,
    limits: Mapping[str, LimitsSection],
    nodes: Sequence[str] | None = None,
) -> ForecastDocument:
    return forecast_document(
        result,
        presentation.limits_document(limits),
        presentation.crossings_document(summary.crossings),
        margin,
        nodes,
    )


def what_if_document(
    state: EstimatedState,
    limits: Mapping[str, LimitsSection],
    profile: Sequence[ProfileStep],
    step_s: float | None,
    nodes: Sequence[str] | None,
    missing: Sequence[str] = (),
) -> WhatIf:
    """Forecast a profile from a state, as the REST interface shows it; see `issue_what_if`."""
    return issue_what_if(state, limits, profile, step_s, nodes, missing)[0]


def issue_what_if(
    state: EstimatedState,
    limits: Mapping[str, LimitsSection],
    profile: Sequence[ProfileStep],
    step_s: float | None,
    nodes: Sequence[str] | None,
    missing: Sequence[str] = (),
) -> tuple[WhatIf, LiveIssue]:
    """Forecast a profile from a state, as the REST interface shows it, and as it was issued.

    Parameters
    ----------
    state : EstimatedState
        Where the forecast starts from.
    limits : mapping of str to LimitsSection
        By sensor.
    profile : sequence of ProfileStep
        What the machine is to do.
    step_s : float, optional
        Spacing of the answer.
    nodes : sequence of str, optional
        Sensors and nodes to be answered; by default all.
    missing : sequence of str
        Operating channels without a usable value.
    """
    steps = _steps(state, profile)
    ahead = operating_profile(steps, step_s or FORECAST_ROW_S, state.point.inputs)
    result, margin = _make(state, ahead)
    summary = presentation.summarize(result, limits, state.time_us)
    answer = WhatIf(
        **dict(_document(result, margin, summary, limits, nodes)),
        model_version=state.active.version,
        profile=presentation.steps_document(steps),
        missing=list(missing),
    )
    return answer, LiveIssue(state, steps, result, None)


def _steps(state: EstimatedState, profile: Sequence[ProfileStep]) -> list[StepAhead]:
    return [
        StepAhead(
            step.duration_s,
            step.speed_rpm,
            step.load_n,
            state.point.ambient_c if step.ambient_c is None else step.ambient_c,
        )
        for step in profile
    ]


def _beyond_times(plan: PlannedProfile) -> list[tuple[float, ...]]:
    """What a plan demands, whatever time is left in its steps."""
    return [tuple(step[1:]) for step in plan.steps]
