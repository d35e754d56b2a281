"""Forecasts by need: what is carried on is what an ensemble would say, and only where it may be."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from service.clock import from_rfc3339, rfc3339
from service.documents.forecasts import forecast_document
from service.live.estimate import EstimatedState, LiveEstimate
from service.live.issues import LiveIssue
from service.live.presentation import limit_crossings
from service.live.profiles import StepAhead, held, operating_profile
from service.live.reuse import (
    REUSED_FOR_S,
    Ensemble,
    is_current,
    is_like,
    keep_ensemble,
    renewal_phase,
    reuse,
)
from service.site.asset_section import LimitsSection
from twin_core.forecasting import forecast
from twin_core.simulation import OperatingProfile

from .conftest import asset_section, make_version

LIMITS = {
    "t_inner_ring_c": LimitsSection(warning=90, alarm=105),
    "t_node_7_c": LimitsSection(warning=95, alarm=110),
}
START_US = 1_800_000_000_000_000
#: Ten seconds before a full quarter of an hour: a period begins just before the ensemble is made.
PHASE = 1.0 - 10.0 / REUSED_FOR_S
WARM = {
    "speed_rpm": 2400.0,
    "load_n": 2650.0,
    "ambient_c": 23.0,
    "t_inner_ring_c": 50.0,
    "t_outer_ring_c": 37.0,
}


def followed(estimate: LiveEstimate, begin_s: float, end_s: float) -> EstimatedState:
    """Follow a machine that slowly gets warmer."""
    for second in np.arange(begin_s, end_s, 5.0):
        warmer_k = 4.0 * (1.0 - np.exp(-second / 3600.0))
        readings = {
            name: value + (warmer_k if name.startswith("t_") else 0.0)
            for name, value in WARM.items()
        }
        estimate.step(START_US + round(second * 1e6), readings)
    state = estimate.state()
    assert state is not None
    return state


def profile_of(state: EstimatedState, **change: float) -> OperatingProfile:
    point = replace(state.point, **change) if change else state.point
    return operating_profile(held(point, 4 * 3600.0), 60.0, point.inputs)


def ensemble(
    state: EstimatedState, limits: dict[str, LimitsSection] = LIMITS, **change: float
) -> Ensemble | None:
    profile = profile_of(state, **change)
    active = state.active
    result = forecast(active.model, active.posterior, state.machine, profile, members=200)
    return keep_ensemble(result, None, state, profile, limits)


@pytest.fixture
def states() -> tuple[EstimatedState, EstimatedState]:
    """A machine after an hour, and 14 minutes later."""
    estimate = LiveEstimate(make_version())
    return followed(estimate, 0.0, 3600.0), followed(estimate, 3600.0, 3600.0 + 840.0)


def test_what_is_carried_on_is_what_an_ensemble_would_say(
    states: tuple[EstimatedState, EstimatedState],
) -> None:
    before, now = states
    kept, profile = ensemble(before), profile_of(now)
    assert kept is not None
    assert is_like(kept, now, profile, PHASE)
    result = reuse(kept, now, profile, LIMITS)
    assert result is not None
    active = now.active
    fresh = forecast(active.model, active.posterior, now.machine, profile, members=200)
    assert result.names == fresh.names
    assert np.abs(result.quantiles[2] - fresh.quantiles[2]).max() < 0.3
    width = fresh.quantiles[-1] - fresh.quantiles[0]
    assert np.abs(result.quantiles[-1] - fresh.quantiles[-1]).max() < 0.15 * width.max() + 0.2
    assert np.abs(result.quantiles[0] - fresh.quantiles[0]).max() < 0.15 * width.max() + 0.2
    # Nothing is made up: without the move it would be wrong by more.
    assert np.abs(kept.result.quantiles[2] - fresh.quantiles[2]).max() > 0.3
    crossings = limit_crossings(result, LIMITS)
    assert {one.probability for levels in crossings.values() for one in levels.values()} == {0.0}


def test_an_ensemble_near_a_limit_is_not_kept(
    states: tuple[EstimatedState, EstimatedState],
) -> None:
    before, now = states
    kept = ensemble(before)
    assert kept is not None
    highest_c = float(kept.result.quantile("t_inner_ring_c")[-1].max())
    near = {"t_inner_ring_c": LimitsSection(warning=highest_c + 4.0, alarm=highest_c + 50.0)}
    assert ensemble(before, near) is None
    assert reuse(kept, now, profile_of(now), near) is None
    node_c = float(kept.result.quantile("t_node_7_c")[-1].max())
    near = {"t_node_7_c": LimitsSection(warning=node_c + 4.0, alarm=node_c + 50.0)}
    assert reuse(kept, now, profile_of(now), near) is None


def test_the_few_members_near_a_limit_are_carried_with_the_rest(
    states: tuple[EstimatedState, EstimatedState],
) -> None:
    before, now = states
    active = before.active
    profile = profile_of(before)
    result = forecast(active.model, active.posterior, before.machine, profile, members=200)
    highest_c = np.sort(result.members_c[:, :, 0].max(axis=1))
    # Four members exceed the alarm, and the upper bound of all stays clear of the warning.
    members_c = result.members_c.copy()
    hottest = np.argsort(members_c[:, :, 0].max(axis=1))[-4:]
    members_c[hottest] += 40.0
    result = replace(result, members_c=members_c)
    limit_c = float(highest_c[-1]) + 15.0
    limits = {result.sensors[0]: LimitsSection(warning=limit_c, alarm=limit_c + 1.0)}
    kept = keep_ensemble(result, None, before, profile, limits)
    assert kept is not None
    assert kept.result.members_c.shape[0] == 4
    ahead = profile_of(now)
    reused = reuse(kept, now, ahead, limits)
    assert reused is not None
    then, later = (limit_crossings(one, limits)[result.sensors[0]] for one in (result, reused))
    assert then["alarm"].probability == later["alarm"].probability == 4 / 200
    # They move with the path of now.
    moved_k = reused.quantiles[2] - kept.result.quantiles[2]
    expected_c = members_c[np.sort(hottest), :, 0] + moved_k[:, 0]
    assert np.abs(reused.members_c[:4, :, 0] - expected_c).max() < 1e-3
    members_c[np.argsort(highest_c)[:11]] += 40.0
    result = replace(result, members_c=members_c)
    assert keep_ensemble(result, None, before, profile, limits) is None


def test_another_point_model_or_age_needs_an_ensemble(
    states: tuple[EstimatedState, EstimatedState],
) -> None:
    before, now = states
    kept = ensemble(before)
    assert kept is not None
    assert is_like(kept, now, profile_of(now), PHASE)
    for change in (
        {"speed_rpm": now.point.speed_rpm * 1.03},
        {"load_n": now.point.load_n * 1.03},
        {"ambient_c": now.point.ambient_c + 3.0},
    ):
        assert not is_like(kept, now, profile_of(now, **change), PHASE), change
    late = replace(now, time_us=before.time_us + round(REUSED_FOR_S * 1e6) + 1)
    assert not is_like(kept, late, profile_of(now), PHASE)
    early = replace(now, time_us=before.time_us - 1)
    assert not is_like(kept, early, profile_of(now), PHASE)
    other = replace(now, active=replace(now.active, version=2))
    assert not is_like(kept, other, profile_of(now), PHASE)
    steps = [StepAhead(600.0, *_point(now)), StepAhead(3600.0, *_point(now))]
    assert not is_like(kept, now, operating_profile(steps, 60.0, now.point.inputs), PHASE)


def test_fresh_grease_a_new_start_or_a_lost_sensor_need_an_ensemble(
    states: tuple[EstimatedState, EstimatedState],
) -> None:
    before, now = states
    kept = ensemble(before)
    assert kept is not None
    for change in ({"revolutions": 0.0}, {"course_known": 0.0}):
        changed = replace(now, machine=replace(now.machine, **change))
        assert not is_like(kept, changed, profile_of(now), PHASE), change


def test_intervals_follow_what_is_known_less_for_a_while_but_not_at_a_limit(
    states: tuple[EstimatedState, EstimatedState],
) -> None:
    before, now = states
    kept = ensemble(before)
    assert kept is not None
    known = reuse(kept, now, profile_of(now), LIMITS)
    assert known is not None

    def less_known(variance: float, limits: dict[str, LimitsSection]) -> Any:
        machine = replace(now.machine, covariance=variance * before.machine.covariance)
        return reuse(kept, replace(now, machine=machine), profile_of(now), limits)

    assert less_known(2.0, LIMITS) is None, "the node with limits is known much less"
    wider = less_known(2.0, {"t_inner_ring_c": LIMITS["t_inner_ring_c"]})
    assert wider is not None
    place = wider.names.index("t_node_3_c")
    widths_k = (one.quantiles[-1] - one.quantiles[0] for one in (wider, kept.result))
    ratio = np.divide(*widths_k)[:, place]
    assert np.allclose(ratio, np.sqrt(2.0), rtol=0.01)
    assert np.array_equal(wider.quantiles[2], known.quantiles[2]), "the middle stays"
    assert less_known(3.0, {"t_inner_ring_c": LIMITS["t_inner_ring_c"]}) is None


def test_a_state_that_has_moved_far_needs_an_ensemble(
    states: tuple[EstimatedState, EstimatedState],
) -> None:
    before, now = states
    kept = ensemble(before)
    assert kept is not None
    for degrees in (5.0, -5.0):
        machine = replace(now.machine, temperatures_c=now.machine.temperatures_c + degrees)
        assert reuse(kept, replace(now, machine=machine), profile_of(now), LIMITS) is None


def _point(state: EstimatedState) -> tuple[float, float, float]:
    return state.point.speed_rpm, state.point.load_n, state.point.ambient_c


async def test_ensembles_are_made_where_a_plan_or_somebody_who_looks_needs_them(
    make_live: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Ten minutes pass each second here, and a forecast is made every two.
    monkeypatch.setattr("service.live.forecasting.LOOKED_AT_FOR_WALL_S", 2.5)
    monkeypatch.setattr("service.live.reuse.REUSED_FOR_S", 4 * 3600.0)
    limits = {"t_inner_ring_c": {"warning": 115, "alarm": 125}}
    live = make_live(asset_section(limits=limits))
    issues: list[LiveIssue] = []
    live.runtime.follow_forecasts(
        SimpleNamespace(name="test", issued=issues.append, to_dict=lambda: None)
    )
    live.start()
    seen = []

    async def next_forecast(what: str) -> Any:
        last = live.documents.forecast()
        made_at = last and last.made_at
        seen.append(
            await live.until(
                lambda: (f := live.documents.forecast()) and f.made_at != made_at and f, what, WARM
            )
        )
        return seen[-1]

    first = await next_forecast("a forecast")
    assert first.intervals_made_at == first.made_at

    async def until(reused: bool, what: str) -> Any:
        for _ in range(20):
            found = await next_forecast(what)
            if (found.intervals_made_at != found.made_at) == reused:
                return found
        raise AssertionError(f"{what}: {[(f.made_at, f.intervals_made_at) for f in seen]}")

    found = await until(True, "intervals carried on")
    age_us = from_rfc3339(found.made_at) - from_rfc3339(found.intervals_made_at)
    assert 0 < age_us <= 4 * 3600 * 1_000_000
    # What is shown is made for who asks: the same numbers as were issued.
    issued = forecast_document(issues[-1].result, {}, {}, None)
    assert rfc3339(issues[-1].state.time_us) == found.made_at
    assert (found.nodes, found.whole_run) == (issued.nodes, issued.whole_run)
    live.runtime.look()
    await until(False, "an ensemble for who looks")
    await until(True, "nobody looks any more")
    live.plan((3600.0, 2400.0, 2650.0), (3600.0, 2600.0, 2650.0))
    planned = await until(False, "an ensemble along the plan")
    assert planned.planned
    # A forecast is never older than its period because it was carried on.
    assert live.runtime.forecast_age_s() < 3600.0


def test_a_fleet_that_starts_at_once_has_no_peak_of_ensembles() -> None:
    """As `make` asks, every 45 s: no moment has many more than the others, nor lasts any longer."""
    count, every_us, looks = 1000, 45_000_000, 320
    made_us = dict.fromkeys(
        (renewal_phase(f"bearing-{number}") for number in range(count)), START_US
    )
    assert len(made_us) == count
    renewed = []
    for look in range(1, looks + 1):
        now_us = START_US + look * every_us
        due = [phase for phase, at_us in made_us.items() if not is_current(at_us, now_us, phase)]
        assert max(now_us - at_us for at_us in made_us.values()) <= REUSED_FOR_S * 1e6 + every_us
        made_us |= dict.fromkeys(due, now_us)
        renewed.append(len(due))
    mean = every_us / 1e6 / REUSED_FOR_S * count
    assert sum(renewed) == pytest.approx(looks * mean, rel=0.01)
    assert max(renewed) < 1.6 * mean
    assert min(renewed) > 0.5 * mean
