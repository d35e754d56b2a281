"""Envelope and advice of a running asset: their documents, and what is kept."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.documents.envelope import (
    EnvelopeDocument,
    EnvelopeMaps,
    LimitMap,
    RunawayMap,
    SensorMaps,
    SteadyMap,
)
from service.documents.limits import LowRisk
from service.domain.errors import NotIdentifiedError
from service.domain.requests import ProfileStep
from service.features.advice.documents import AdviceDocument
from service.live.envelope_keeper import grid, with_present
from service.live.estimate import RunningModel
from twin_core import profiles
from twin_core.identification.posterior import TrainedRange
from twin_core.operating_points import OperatingSpan

from .conftest import asset_section, make_version

RING = "t_inner_ring_c"
RUNNING = {
    "speed_rpm": 4200.0,
    "load_n": 2650.0,
    "ambient_c": 23.0,
    "t_inner_ring_c": 48.0,
    "t_outer_ring_c": 40.0,
}
SENSORS = {"t_inner_ring_c", "t_outer_ring_c"}


def identified(version: RunningModel) -> RunningModel:
    """The version as if it had been identified from four hours at one point."""
    points = (OperatingSpan(4200.0, 2650.0, 14400.0, 0.0),)
    posterior = replace(
        version.posterior,
        covariance=0.3**2 * np.eye(version.posterior.z.size),
        trained=TrainedRange(points, 240, True, 0.0),
    )
    return replace(version, posterior=posterior, identified_at_us=1)


@pytest.fixture(autouse=True)
def small_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole map takes a second of two processors; these tests are not about its size."""
    monkeypatch.setattr("service.live.envelope_keeper.SPEEDS", 4)
    monkeypatch.setattr("service.live.envelope_keeper.LOADS", 3)


@pytest.fixture
async def live(make_live: Callable[..., Any]) -> Any:
    live = make_live(active=identified(make_version(3)))
    live.start()
    live.feed(RUNNING)
    await live.until(lambda: live.runtime.estimate.started, "an estimate", RUNNING)
    return live


# ---------------------------------------------------------------------------- margin
async def test_a_forecast_carries_the_margin_to_a_runaway_of_an_identified_model(
    live: Any, make_live: Callable[..., Any]
) -> None:
    heavy = ProfileStep(duration_s=3600.0, speed_rpm=6200.0, load_n=5500.0)
    light = ProfileStep(duration_s=3600.0, speed_rpm=4200.0, load_n=2650.0)
    made, calm = (live.what_if([light, step], 600.0).runaway_margin for step in (heavy, light))
    assert (made.speed_rpm, made.load_n) == (6200.0, 5500.0)
    assert calm.probability < made.probability
    assert calm.margin_k > made.margin_k
    held = (await live.until(live.documents.forecast, "a forecast", RUNNING)).runaway_margin
    assert (held.speed_rpm, held.load_n) == pytest.approx((4200.0, 2650.0))
    assert held.probability == pytest.approx(calm.probability, abs=0.01)
    unknown = make_live(active=make_version(1))
    unknown.start()
    forecast = await unknown.until(unknown.documents.forecast, "a forecast", RUNNING)
    assert forecast.runaway_margin is None


# ---------------------------------------------------------------------------- envelope
async def test_envelope_document_has_the_shape_it_promises(live: Any) -> None:
    document = live.envelope()
    shown = EnvelopeDocument.model_validate_json(document.to_bytes())
    shape = (len(shown.load_n), len(shown.speed_rpm))
    assert shape == (3, 4)
    assert set(shown.sensors) == SENSORS
    inner = shown.sensors["t_inner_ring_c"]
    assert set(inner.limits) == {"warning", "alarm"}
    assert inner.limits["warning"].limit_c == 70.0
    assert shown.sensors["t_outer_ring_c"].limits == {}
    warning = inner.limits["warning"]
    for matrix in (
        inner.steady_c.q025,
        inner.steady_c.q975,
        warning.probability,
        warning.steady_probability,
        warning.median_s,
        warning.earliest_s,
        shown.runaway.probability,
        shown.runaway.not_excluded,
        shown.runaway.loop_gain,
        shown.runaway.loop_gain_upper,
        shown.runaway.margin_k,
        shown.runaway.margin_n,
    ):
        assert np.shape(matrix) == shape
    assert shown.model_version == 3
    assert shown.labels == []
    assert (shown.present.speed_rpm, shown.present.load_n) == (4200.0, 2650.0)
    assert shown.low_risk.speed_rpm_max == 4300.0
    # the corner that is never safe, and the one that always is
    assert warning.probability[0][0] == 0.0
    assert warning.median_s[0][0] is None
    assert inner.steady_c.q975[-1][-1] > inner.steady_c.q975[0][0]


async def test_envelope_is_kept_until_the_model_changes(live: Any) -> None:
    first, second = live.envelope(), live.envelope()
    assert second.sensors[RING] is first.sensors[RING]
    live.runtime.switch(identified(make_version(4, z=0.3)))
    third = live.envelope()
    assert third.model_version == 4
    assert third.sensors != first.sensors


async def test_envelope_follows_the_machine(live: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.live.envelope_keeper.LEAST_WALL_S", 0.0)
    first = live.envelope()
    hot = RUNNING | {"t_inner_ring_c": 63.0, "t_outer_ring_c": 52.0}
    row = live.runtime.active.model.sensor_row("t_inner_ring_c")
    await live.until(
        lambda: row @ live.runtime.estimate.observer.temperatures_c > 60.0, "a hot machine", hot
    )
    second = live.envelope()
    assert second.sensors[RING] is not first.sensors[RING]
    assert second.made_at > first.made_at


async def test_an_envelope_from_priors_says_so(make_live: Callable[..., Any]) -> None:
    live = make_live(active=make_version(1))
    live.start()
    await live.until(lambda: live.runtime.estimate.started, "an estimate", RUNNING)
    document = live.envelope()
    assert document.labels == ["not identified yet: prior parameters only"]
    with pytest.raises(NotIdentifiedError, match="identify first"):
        live.advice(6200.0, 5500.0, 7200.0)


async def test_the_grid_reaches_beyond_region_and_plan(
    live: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = asset_section()
    monkeypatch.undo()
    speed_rpm, load_n = grid(section, [(4200.0, 2650.0)])
    assert (speed_rpm.size, load_n.size) == (20, 15)
    assert speed_rpm[-1] >= 1.6 * 4300.0
    assert load_n[-1] >= 2.2 * 3400.0
    assert np.all(speed_rpm % 50.0 == 0.0)
    assert np.all(load_n % 50.0 == 0.0)
    live.plan((3600.0, 9000.0, 2650.0))
    document = live.envelope()
    assert np.shape(document.runaway.probability) == (15, 20)
    assert document.speed_rpm[-1] >= 9900.0


# ---------------------------------------------------------------------------- advice
async def test_advice_document_has_the_shape_it_promises(live: Any) -> None:
    document = live.advice(6200.0, 5500.0, 3600.0)
    shown = AdviceDocument.model_validate_json(document.to_bytes())
    assert shown.model_version == 3
    assert (shown.target.speed_rpm, shown.target.load_n) == (6200.0, 5500.0)
    assert not shown.target.inside_low_risk
    assert set(shown.target.sensors) == SENSORS
    assert [step.rank for step in shown.steps] == list(range(1, len(shown.steps) + 1))
    assert shown.steps
    for step in shown.steps:
        assert step.duration_s == sum(level.duration_s for level in step.levels)
        assert all(level.speed_rpm <= 4300.0 for level in step.levels)
        assert step.peak_c["t_inner_ring_c"] < 70.0
    assert any("at once" in step.reason for step in shown.excluded)
    last = shown.stop_rule.levels[-1]
    assert (last.speed_rpm, last.load_n) == (6200.0, 5500.0)
    assert set(last.stop_above_c) == SENSORS
    assert len(shown.stop_rule.rules) >= 4
    inside = live.advice(4200.0, 3000.0, 3600.0)
    assert inside.target.inside_low_risk


async def test_the_next_step_is_said_in_plain_words_until_the_asked_width_is_reached(
    live: Any,
) -> None:
    found = live.advice(6200.0, 5500.0, 3600.0)
    now_k = found.target.sensors[found.target.sensor].half_width_k
    step = found.steps[found.next_step.rank - 1]
    assert step.duration_s <= 1200.0
    first, after_k = step.levels[0], step.cautious_half_width_k[found.target.sensor]
    assert found.next_step.text.startswith(
        f"{first.duration_s / 60:.0f} min at {first.load_n:.0f} N, {first.speed_rpm:.0f} rpm"
    )
    said = f"± {now_k:.1f} K at 5500 N, 6200 rpm becomes ± {after_k:.1f} K."
    assert said in found.next_step.text
    near = live.advice(6200.0, 5500.0, 3600.0, 0.01)
    assert near.next_step.asked_half_width_k == 0.01
    assert "asked are ± 0.01 K." in near.next_step.text
    enough = live.advice(6200.0, 5500.0, 3600.0, now_k + 0.1)
    assert enough.next_step.reached
    assert enough.next_step.rank is None
    assert "is reached, nothing more is needed." in enough.next_step.text


def maps_of(steady: list[list[float]], likely: list[list[float]]) -> EnvelopeMaps:
    """Maps of one ring over two speeds and two loads, with limits at 70 and 95 °C."""
    cool, unlikely = [[0.0, 0.0]] * 2, [[None, None]] * 2
    limits = {
        level: LimitMap(
            limit_c=limit_c,
            probability=cool,
            steady_probability=likely,
            median_s=unlikely,
            earliest_s=unlikely,
        )
        for level, limit_c in (("warning", 70.0), ("alarm", 95.0))
    }
    shown = SteadyMap(q025=cool, q50=steady, q975=cool)
    return EnvelopeMaps(
        made_at="2026-11-21T08:00:00.000Z",
        model_version=2,
        ambient_c=23.0,
        horizon_s=28_800.0,
        members=80,
        speed_rpm=[1000.0, 2000.0],
        load_n=[1000.0, 3000.0],
        sensors={RING: SensorMaps(steady_c=shown, limits=limits)},
        runaway=RunawayMap(
            probability=cool,
            not_excluded=[[False, False]] * 2,
            loop_gain=cool,
            loop_gain_upper=cool,
            margin_k=cool,
            margin_n=cool,
        ),
        low_risk=LowRisk(speed_rpm_max=4300.0, load_n_max=3000.0),
        labels=[],
    )


def test_the_envelope_says_where_the_present_point_is_measured_hotter_than_its_map() -> None:
    """The ring was at 77 °C over a warning of 70, and the map rated the point 61 °C."""
    maps = maps_of(steady=[[40.0, 50.0], [45.0, 61.0]], likely=[[0.0, 0.0]] * 2)
    point = profiles.Point(1900.0, 2650.0, 23.0)
    shown = with_present(maps, point, {RING: 77.1})
    assert shown.present.measured_c == {RING: 77.1}
    assert shown.labels == [
        "Inner ring measured 77.1 °C at the present point, over warning 70 °C: "
        "the map shows 61.0 °C there"
    ]
    for calm in (60.0, None):
        assert with_present(maps, point, {RING: calm}).labels == []


def test_the_envelope_rates_the_present_point_no_lower_than_what_is_measured_there() -> None:
    """36 % over the warning, said the map, and the ring was over it."""
    maps = maps_of(steady=[[40.0, 50.0], [45.0, 61.0]], likely=[[0.0, 0.0], [0.05, 0.36]])
    point = profiles.Point(1900.0, 2650.0, 23.0)

    def rated(reading_c: float | None) -> dict[str, Any]:
        return with_present(maps, point, {RING: reading_c}).present.over_limit[RING]

    assert rated(77.1) == {"warning": 1.0, "alarm": 0.36}
    assert rated(95.0) == {"warning": 1.0, "alarm": 1.0}
    for calm in (69.9, None):
        assert rated(calm) == {"warning": 0.36, "alarm": 0.36}, "as the map has it"
