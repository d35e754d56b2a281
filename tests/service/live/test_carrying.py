"""Forecasts by need: what is carried on is what an ensemble would say, and only where it may be."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.clock import from_rfc3339
from service.live.carrying import CARRIED_FOR_S, Ensemble, carried, is_like, keep_ensemble
from service.live.estimate import EstimatedState, LiveEstimate
from service.live.presentation import limit_crossings
from service.live.profiles import Step, held, operating_profile
from service.site.asset_section import Limits
from twin_core.forecasting import forecast
from twin_core.simulation import OperatingProfile

LIMITS = {
    "t_inner_ring_c": Limits(warning=90, alarm=105),
    "t_node_7_c": Limits(warning=95, alarm=110),
}
START_US = 1_800_000_000_000_000
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
    state: EstimatedState, limits: dict[str, Limits] = LIMITS, **change: float
) -> Ensemble | None:
    profile = profile_of(state, **change)
    active = state.active
    result = forecast(active.model, active.posterior, state.machine, profile, members=200)
    return keep_ensemble(result, None, state, profile, limits)


@pytest.fixture
def states(make_version: Callable[..., Any]) -> tuple[EstimatedState, EstimatedState]:
    """A machine after an hour, and 14 minutes later."""
    estimate = LiveEstimate(make_version())
    return followed(estimate, 0.0, 3600.0), followed(estimate, 3600.0, 3600.0 + 840.0)


def test_what_is_carried_on_is_what_an_ensemble_would_say(
    states: tuple[EstimatedState, EstimatedState],
) -> None:
    before, now = states
    kept, profile = ensemble(before), profile_of(now)
    assert kept is not None
    assert is_like(kept, now, profile)
    result = carried(kept, now, profile, LIMITS)
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
    near = {"t_inner_ring_c": Limits(warning=highest_c + 4.0, alarm=highest_c + 50.0)}
    assert ensemble(before, near) is None
    assert carried(kept, now, profile_of(now), near) is None
    node_c = float(kept.result.quantile("t_node_7_c")[-1].max())
    near = {"t_node_7_c": Limits(warning=node_c + 4.0, alarm=node_c + 50.0)}
    assert carried(kept, now, profile_of(now), near) is None


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
    limits = {result.sensors[0]: Limits(warning=limit_c, alarm=limit_c + 1.0)}
    kept = keep_ensemble(result, None, before, profile, limits)
    assert kept is not None
    assert kept.result.members_c.shape[0] == 4
    ahead = profile_of(now)
    carried_on = carried(kept, now, ahead, limits)
    assert carried_on is not None
    then, later = (limit_crossings(one, limits)[result.sensors[0]] for one in (result, carried_on))
    assert then["alarm"].probability == later["alarm"].probability == 4 / 200
    # They move with the path of now.
    moved_k = carried_on.quantiles[2] - kept.result.quantiles[2]
    expected_c = members_c[np.sort(hottest), :, 0] + moved_k[:, 0]
    assert np.abs(carried_on.members_c[:4, :, 0] - expected_c).max() < 1e-3
    members_c[np.argsort(highest_c)[:11]] += 40.0
    result = replace(result, members_c=members_c)
    assert keep_ensemble(result, None, before, profile, limits) is None


def test_another_point_model_or_age_needs_an_ensemble(
    states: tuple[EstimatedState, EstimatedState],
) -> None:
    before, now = states
    kept = ensemble(before)
    assert kept is not None
    assert is_like(kept, now, profile_of(now))
    for change in (
        {"speed_rpm": now.point.speed_rpm * 1.03},
        {"load_n": now.point.load_n * 1.03},
        {"ambient_c": now.point.ambient_c + 3.0},
    ):
        assert not is_like(kept, now, profile_of(now, **change)), change
    late = replace(now, time_us=before.time_us + round(CARRIED_FOR_S * 1e6) + 1)
    assert not is_like(kept, late, profile_of(now))
    early = replace(now, time_us=before.time_us - 1)
    assert not is_like(kept, early, profile_of(now))
    other = replace(now, active=replace(now.active, version=2))
    assert not is_like(kept, other, profile_of(now))
    steps = [Step(600.0, *_point(now)), Step(3600.0, *_point(now))]
    assert not is_like(kept, now, operating_profile(steps, 60.0, now.point.inputs))


def test_fresh_grease_a_new_start_or_a_lost_sensor_need_an_ensemble(
    states: tuple[EstimatedState, EstimatedState],
) -> None:
    before, now = states
    kept = ensemble(before)
    assert kept is not None
    for change in (
        {"revolutions": 0.0},
        {"course_known": 0.0},
    ):
        changed = replace(now, machine=replace(now.machine, **change))
        assert not is_like(kept, changed, profile_of(now)), change


def test_intervals_follow_what_is_known_less_for_a_while_but_not_at_a_limit(
    states: tuple[EstimatedState, EstimatedState],
) -> None:
    before, now = states
    kept = ensemble(before)
    assert kept is not None
    known = carried(kept, now, profile_of(now), LIMITS)
    assert known is not None

    def less_known(variance: float, limits: dict[str, Limits]) -> Any:
        machine = replace(now.machine, covariance=variance * before.machine.covariance)
        return carried(kept, replace(now, machine=machine), profile_of(now), limits)

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
        assert carried(kept, replace(now, machine=machine), profile_of(now), LIMITS) is None


def _point(state: EstimatedState) -> tuple[float, float, float]:
    return state.point.speed_rpm, state.point.load_n, state.point.ambient_c


async def test_ensembles_are_made_where_a_plan_or_somebody_who_looks_needs_them(
    make_live: Callable[..., Any],
    make_section: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Ten minutes pass each second here, and a forecast is made every two.
    monkeypatch.setattr("service.live.forecasting.LOOKED_AT_FOR_WALL_S", 2.5)
    monkeypatch.setattr("service.live.carrying.CARRIED_FOR_S", 4 * 3600.0)
    limits = {"t_inner_ring_c": {"warning": 115, "alarm": 125}}
    live = make_live(make_section(limits=limits))
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

    async def until(carried_on: bool, what: str) -> Any:
        for _ in range(20):
            found = await next_forecast(what)
            if (found.intervals_made_at != found.made_at) == carried_on:
                return found
        raise AssertionError(f"{what}: {[(f.made_at, f.intervals_made_at) for f in seen]}")

    found = await until(True, "intervals carried on")
    age_us = from_rfc3339(found.made_at) - from_rfc3339(found.intervals_made_at)
    assert 0 < age_us <= 4 * 3600 * 1_000_000
    live.runtime.look()
    await until(False, "an ensemble for who looks")
    await until(True, "nobody looks any more")
    live.plan((3600.0, 2400.0, 2650.0), (3600.0, 2600.0, 2650.0))
    planned = await until(False, "an ensemble along the plan")
    assert planned.planned
    # A forecast is never older than its period because it was carried on.
    assert live.runtime.forecast_age_s() < 3600.0
