"""Which live forecasts are kept, and what is kept of them."""

import asyncio
import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.samples import PlannedProfile, PlanStep
from service.clock import rfc3339
from service.documents.forecasts import WhatIf
from service.domain.requests import ProfileStep
from service.features.ledger.keeping import (
    KEPT_EVERY_S,
    KeptForecastsOf,
    LedgerRule,
    issued_forecast,
)
from service.live.estimate import EstimatedState, LiveEstimate, RunningModel
from service.live.forecasting import issue_what_if
from service.live.issues import LiveIssue
from service.live.profiles import StepAhead
from service.site.asset_section import AssetSection
from service.store.forecast_records import IssuedForecast
from tests.service.live.conftest import asset_section, make_version
from twin_core.naive import NaiveForecasts
from twin_core.profiles import Point
from twin_core.verification import LEAD_TIMES_S

SECOND = 1_000_000
WARM = {
    "speed_rpm": 2400.0,
    "load_n": 2650.0,
    "ambient_c": 23.0,
    "t_inner_ring_c": 55.0,
    "t_outer_ring_c": 38.0,
}
RUNNING = [StepAhead(14_400.0, 2400.0, 2650.0, 23.0)]
RINGS = ["t_inner_ring_c", "t_outer_ring_c"]


def issue(
    at_s: float,
    version: int = 1,
    plan: tuple[tuple[float, float, float], ...] | None = None,
    steps: list[StepAhead] = RUNNING,
) -> LiveIssue:
    """A live forecast as far as the rule looks at it."""
    active = RunningModel(version, None, None, None)  # type: ignore[arg-type]
    point = Point(2400.0, 2650.0, 23.0)
    state = EstimatedState(active, None, point, round(at_s * SECOND))  # type: ignore[arg-type]
    profile = None
    if plan is not None:
        profile = PlannedProfile("a", 0, tuple(PlanStep(*step) for step in plan))
    return LiveIssue(state, steps, None, profile)  # type: ignore[arg-type]


PLAN = ((1000.0, 1500.0, 2650.0), (1000.0, 2400.0, 2650.0), (5000.0, 2400.0, 3300.0))


def test_each_step_each_version_and_every_ten_minutes() -> None:
    rule, kept = LedgerRule(), []
    for at_s in range(0, 4000, 45):
        reason = rule.reason(issue(at_s, version=1 if at_s < 3000 else 2, plan=PLAN))
        if reason:
            kept.append((at_s, reason))
    assert kept == [
        (0, "step"), (630, "period"), (1035, "step"), (1665, "period"), (2025, "step"),
        (2655, "period"), (3015, "model"), (3645, "period"),
    ]  # fmt: skip


@settings(max_examples=80, deadline=None)
@given(st.lists(st.floats(1, 3000), min_size=1, max_size=60), st.data())
def test_never_silent_for_long_nor_twice_in_ten_minutes_without_a_reason(
    waits_s: list[float], data: st.DataObject
) -> None:
    """At any times, and with any restarts of the service between them."""
    rule, at_s, last_s = LedgerRule(), 0.0, -1e9
    for wait_s in waits_s:
        at_s += wait_s
        if data.draw(st.booleans()):
            again = LedgerRule()
            if known := rule.to_dict():
                again.restore(json.loads(json.dumps(known)))
            rule = again
        reason = rule.reason(issue(at_s))
        assert (reason == "period") == (at_s - last_s >= KEPT_EVERY_S - 1e-6)
        if reason:
            last_s = at_s
        assert rule.reason(issue(at_s)) is None


def test_a_machine_that_stands_and_is_going_to_is_not_followed() -> None:
    rule = LedgerRule()
    at_rest = StepAhead(14_400.0, 0.0, 19.0, 23.0)
    assert rule.reason(issue(0, steps=[at_rest])) is None
    assert rule.reason(issue(1, steps=[at_rest, *RUNNING])) == "period"


@pytest.mark.parametrize(
    "kept", [{}, {"time_us": "x", "version": 1, "step": None}, {"time_us": 1, "version": 1,
             "step": [1]}, {"time_us": 1, "version": None, "step": None}],
)  # fmt: skip
def test_what_does_not_fit_is_left_aside(kept: Any) -> None:
    rule = LedgerRule()
    rule.restore(kept)
    assert rule.to_dict() is None
    assert rule.reason(issue(0)) == "period"


def followed(live: Any) -> list[IssuedForecast]:
    """What is kept of a live twin from now on."""
    kept: list[IssuedForecast] = []
    live.runtime.follow_forecasts(KeptForecastsOf(live.runtime, live.clock, kept.append))
    return kept


async def test_the_live_twin_keeps_what_it_shows(make_live: Callable[..., Any]) -> None:
    live = make_live()
    kept = followed(live)
    live.start()
    live.plan((6000.0, 2400.0, 2650.0), (8000.0, 6200.0, 5500.0))
    (first, *_) = await live.until(lambda: kept, "a kept forecast", WARM)
    shown = live.documents.forecast()
    content = first.content
    assert (first.asset, first.reason, first.model_version) == ("bench-1", "step", 1)
    assert content.planned is True
    assert content.channels == RINGS
    assert content.lead_times_s == list(LEAD_TIMES_S[:5])
    assert content.high_risk == [False] * 4 + [True]
    assert [step[1:3] for step in content.steps] == [(2400.0, 2650.0), (6200.0, 5500.0)]
    assert content.steps[1][0] == 8000.0
    assert content.labels == shown.labels
    assert rfc3339(first.time_us) == shown.made_at
    row = shown.time_s.index(600.0)
    of_ring = shown.nodes[RINGS[0]]
    known = [getattr(of_ring, name)[row] for name in ("q025", "q25", "q50", "q75", "q975")]
    assert content.quantiles[1][0] == pytest.approx([100 * value for value in known], abs=0.51)
    assert content.naive == {"persistence": [[5500, 3800]] * 5}
    # Both bands, at as few times as they need: the ones that are shown, within a part of the width.
    assert content.band_times_s[0] == 0.0
    assert content.band_times_s[-1] >= content.lead_times_s[-1]
    assert len(content.band_times_s) < 80
    edges_c = np.array([shown.nodes[name].q025 for name in RINGS])
    width_k = [np.mean(shown.nodes[name].q975) - np.mean(low) for name, low in zip(
        RINGS, edges_c, strict=True)]  # fmt: skip
    rows = np.array(shown.time_s) <= content.band_times_s[-1]
    for place in range(2):
        low_c = np.array(content.bands, float)[:, place, 0] / 100.0
        kept_c = np.interp(np.array(shown.time_s)[rows], content.band_times_s, low_c)
        np.testing.assert_allclose(kept_c, edges_c[place][rows], atol=0.012 * width_k[place])
        edges = np.array(content.bands, float)[:, place]
        assert np.all(edges[:, 2] <= edges[:, 1])
        assert np.all(edges[:, 2] < edges[:, 3])

    # A plan that changes begins another step; an unknown operation is not forecast for the ledger.
    live.plan((1200.0, 3000.0, 2650.0), (9000.0, 6200.0, 5500.0))
    await live.until(lambda: len(kept) > 1, "the next", WARM)
    assert kept[1].reason == "step"
    await live.stop()
    assert live.saved[-1]["ledger"]["step"][1:] == [3000.0, 2650.0]


async def test_nothing_is_kept_of_an_unknown_operation(make_live: Callable[..., Any]) -> None:
    live = make_live()
    kept = followed(live)
    live.start()
    await live.until(lambda: kept, "a kept forecast", WARM)
    blind = {name: value for name, value in WARM.items() if name != "speed_rpm"}
    await live.until(lambda: "speed_rpm" in live.documents.state().missing, "no speed", blind)
    await live.until(lambda: live.documents.forecast().missing, "a blind forecast", blind)
    count = len(kept)
    for _ in range(100):  # ten minutes of process time and more
        live.feed(blind)
        await asyncio.sleep(0.05)
    assert len(kept) == count


def what_if_to_keep(
    section: AssetSection,
    state: EstimatedState,
    profile: list[ProfileStep],
    step_s: float | None,
    nodes: list[str] | None,
    readings_c: dict[str, float | None],
) -> tuple[WhatIf, IssuedForecast | None]:
    answer, issue = issue_what_if(state, section.limits, profile, step_s, nodes)
    region = section.low_risk.region
    return answer, issued_forecast(section.id, issue, "asked", region, section.channels, readings_c)


def test_simple_forecasts_are_issued_at_the_same_moment() -> None:
    naive = NaiveForecasts(
        ("t_inner_ring_c", "t_outer_ring_c"),
        static=np.array([[2.0, 1.0], [10.0, 5.0], [0.0, 0.0]]),
        transition=np.eye(2) * 0.5,
        drive=np.array([[1.0, 0.5], [5.0, 2.5], [0.0, 0.0]]),
        spacing_s=60.0,
    )
    estimate = LiveEstimate(replace(make_version(), naive=naive))
    for at_s in (0, 5):
        estimate.step(1_763_700_000_000_000 + at_s * SECOND, WARM)
    state = estimate.state()
    assert state is not None
    profile = [
        ProfileStep(duration_s=900.0, speed_rpm=2000.0, load_n=2650.0, ambient_c=20.0),
        ProfileStep(duration_s=900.0, speed_rpm=6200.0, load_n=2650.0, ambient_c=20.0),
    ]
    readings = {"t_inner_ring_c": 55.0, "t_outer_ring_c": 38.0}
    answer, issued = what_if_to_keep(asset_section(), state, profile, 600.0, RINGS[:1], readings)
    assert issued is not None
    content = issued.content
    assert list(answer.nodes) == RINGS[:1]
    assert content.channels == RINGS, "also those that were not asked for"
    assert content.lead_times_s == [300, 600, 1800]
    assert content.high_risk == [False, False, True]
    assert content.naive["persistence"] == [[5500, 3800]] * 3
    # Steady excess 2 + 10 * krpm, and the same for ARX once it has settled.
    assert content.naive["linear"] == [[4200, 3100], [4200, 3100], [8400, 5200]]
    arx = np.array(content.naive["arx"]) / 100.0
    np.testing.assert_allclose(arx[1], [42.0, 31.0], atol=0.1)
    assert 42.0 < arx[0][0] < 44.0
    missing = what_if_to_keep(asset_section(), state, profile, None, None, {"t_inner_ring_c": 55.0})
    assert missing[1] is not None
    assert missing[1].content.naive["persistence"] == [[5500, None]] * 3
    short = [ProfileStep(duration_s=200.0, speed_rpm=2000.0, load_n=2650.0)]
    assert what_if_to_keep(asset_section(), state, short, None, None, readings)[1] is None
