"""The live forecast of one asset, and what-if forecasts from a state of it."""

import asyncio
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from typing import NamedTuple

from pydantic_core import to_json

from adapters.protocol import Clock
from adapters.samples import PlannedProfile
from service.clock import rfc3339
from service.documents.forecasts import (
    ForecastDocument,
    LiveForecast,
    WhatIf,
    forecast_document,
)
from service.domain.channels import OPERATING_CHANNELS
from service.domain.requests import ProfileStep
from service.live import presentation
from service.live.carrying import Ensemble, carried, is_like, keep_ensemble
from service.live.estimate import EstimatedState, LiveEstimate
from service.live.outlook import Outlook, step_outlooks
from service.live.presentation import ForecastSummary
from service.live.profiles import Step, held, operating_profile, planned
from service.live.readings import Readings, allowed_age_s
from service.site.settings import AssetSection, Limits
from twin_core.forecasting import Forecast, forecast
from twin_core.profiles import OperatingPoint
from twin_core.simulation import OperatingProfile

FORECAST_ROW_S = 60.0
HORIZON_S = 4 * 3600.0
MEMBERS = 200
#: So long somebody who has asked for a forecast goes on looking at it; process s, and at least so
#: many wall s.
LOOKED_AT_FOR_S, LOOKED_AT_FOR_WALL_S = 300.0, 10.0
_PLAN_MAX_AGE_S = 30.0


class _Made(NamedTuple):
    """A forecast, what tags show of it, and its document."""

    result: Forecast
    summary: ForecastSummary
    document: ForecastDocument


class _Live(NamedTuple):
    """A live forecast, and the ensemble that its intervals are of."""

    made: _Made
    ensemble: Ensemble | None
    intervals_us: int


class Forecasting:
    """Forecasts along the controller's plan, or with the present point held.

    An ensemble is made where a plan lies ahead, a limit is near, the operation is not known or
    somebody looks; else the intervals of the last one are carried on, see `service.live.carrying`.

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
        self._limits = settings.limits
        self._estimate = estimate
        self._readings = readings
        self._clock = clock
        self._executor = executor
        self.plan: PlannedProfile | None = None
        # As text: half a megabyte of numbers otherwise, for each asset, and rarely asked for.
        self._latest: bytes | None = None
        self._carried_on = False
        self.summary: ForecastSummary | None = None
        self.outlook: Outlook | None = None
        self._ensemble: Ensemble | None = None
        self._looked_us: int | None = None

    def look(self) -> bool:
        """Take note that somebody looks; returns whether the latest has intervals of earlier."""
        self._looked_us = self._clock.now_us()
        return self._carried_on

    @property
    def latest(self) -> LiveForecast | None:
        """The latest live forecast; None before the first."""
        return None if self._latest is None else LiveForecast.model_validate_json(self._latest)

    def age_s(self, now_us: int) -> float:
        """Process seconds since the state that the live forecast starts from; NaN before it."""
        return math.nan if self.summary is None else (now_us - self.summary.made_us) / 1e6

    def take_plan(self, plan: PlannedProfile) -> bool:
        """Follow a plan from now on; returns whether it is another one than before."""
        known, self.plan = self.plan, plan
        return known is None or _beyond_times(known) != _beyond_times(plan)

    async def make(self, missing: Sequence[str] = ()) -> LiveForecast | None:
        """Make a new live forecast; None when the plan is over and nothing lies ahead.

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
            return None
        profile = operating_profile(steps, FORECAST_ROW_S, state.point.inputs)
        has_plan = self._has_plan(made_us)
        alone = not (missing or has_plan)
        kept = self._ensemble if alone and not self._is_looked_at(made_us) else None
        loop = asyncio.get_running_loop()
        live = await loop.run_in_executor(
            self._executor, _make_live, state, profile, self._limits, kept, alone
        )
        result, summary, document = live.made
        self._ensemble, self._carried_on = live.ensemble, live.intervals_us != made_us
        latest = LiveForecast(
            **dict(document),
            model_version=version,
            profile=presentation.steps_document(steps),
            missing=list(missing),
            made_at=rfc3339(made_us),
            intervals_made_at=rfc3339(live.intervals_us),
            planned=has_plan,
        )
        self._latest = to_json(latest, inf_nan_mode="null")
        self.summary, self.outlook = summary, None
        if not missing:
            outlooks = step_outlooks(result, steps, self._limits)
            self.outlook = Outlook(made_us, version, outlooks, summary.crossings)
        return latest

    def steps_ahead(self, now_us: int) -> list[Step]:
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
            point = OperatingPoint(speed_rpm, load_n, ambient_c, tuple(inputs))
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
    profile: OperatingProfile,
    limits: Mapping[str, Limits],
    kept: Ensemble | None,
    keeps: bool,
) -> _Live:
    """Carry the kept ensemble on where that is right, else make one, and keep it if wanted."""
    if kept is not None and is_like(kept, state, profile):
        result = carried(kept, state, profile, limits)
        if result is not None:
            return _Live(_shown(result, state, limits), kept, kept.state.time_us)
    made = _make(state, profile, limits)
    ensemble = None
    if keeps:
        crossings = made.summary.crossings
        ensemble = keep_ensemble(made.result, state, profile, limits, crossings)
    return _Live(made, ensemble, state.time_us)


def _make(
    state: EstimatedState,
    profile: OperatingProfile,
    limits: Mapping[str, Limits],
    nodes: Sequence[str] | None = None,
) -> _Made:
    active = state.active
    result = forecast(active.model, active.posterior, state.machine, profile, members=MEMBERS)
    return _shown(result, state, limits, nodes)


def _shown(
    result: Forecast,
    state: EstimatedState,
    limits: Mapping[str, Limits],
    nodes: Sequence[str] | None = None,
) -> _Made:
    # The document too: two days in all nodes are a hundred thousand figures, no work for the event
    # loop.
    summary = presentation.summarize(result, limits, state.time_us)
    document = forecast_document(
        result,
        presentation.limits_document(limits),
        presentation.crossings_document(summary.crossings),
        nodes,
    )
    return _Made(result, summary, document)


def what_if_document(
    state: EstimatedState,
    limits: Mapping[str, Limits],
    profile: Sequence[ProfileStep],
    step_s: float | None,
    nodes: Sequence[str] | None,
    missing: Sequence[str] = (),
) -> WhatIf:
    """Forecast a profile from a state, as the REST interface shows it.

    Parameters
    ----------
    state : EstimatedState
        Where the forecast starts from.
    limits : mapping of str to Limits
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
    steps = [
        Step(
            step.duration_s,
            step.speed_rpm,
            step.load_n,
            state.point.ambient_c if step.ambient_c is None else step.ambient_c,
        )
        for step in profile
    ]
    ahead = operating_profile(steps, step_s or FORECAST_ROW_S, state.point.inputs)
    return WhatIf(
        **dict(_make(state, ahead, limits, nodes).document),
        model_version=state.active.version,
        profile=presentation.steps_document(steps),
        missing=list(missing),
    )


def _beyond_times(plan: PlannedProfile) -> list[tuple[float, ...]]:
    """What a plan demands, whatever time is left in its steps."""
    return [tuple(step[1:]) for step in plan.steps]
