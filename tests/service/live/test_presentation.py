"""Forecasts, states and tags as others read them."""

import json
import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.testing import assert_allclose

from adapters.samples import Quality
from service.documents.forecasts import ForecastDocument, Quantiles, forecast_document
from service.documents.tags import tag
from service.domain.channels import unit_of
from service.live import presentation
from service.live.estimate import LiveEstimate
from service.live.presentation import ForecastSummary, LimitCrossing, LimitCrossings
from service.live.profiles import StepAhead, operating_profile
from service.site.asset_section import LimitsSection
from twin_core.forecasting import Forecast, forecast
from twin_core.machine_state import MachineState

from .conftest import make_version

BEGAN = "2026-11-21T08:00:00.000Z"
START_US = 1_763_700_000_000_000
LIMITS = {
    "t_inner_ring_c": LimitsSection(warning=70, alarm=95),
    "t_outer_ring_c": LimitsSection(warning=65, alarm=80),
    "t_node_7_c": LimitsSection(warning=60, alarm=80),
}


@pytest.fixture
def estimate() -> LiveEstimate:
    return LiveEstimate(make_version())


@pytest.fixture
def hot_forecast() -> Forecast:
    active = make_version()
    profile = operating_profile([StepAhead(7200.0, 9000.0, 12_000.0, 23.0)], 600.0)
    state = MachineState(np.full(13, 23.0), 0.01 * np.eye(13), 0.0, 23.0)
    return forecast(active.model, active.posterior, state, profile, members=50)


def shown_of(result: Forecast, names: Sequence[str] | None = None) -> ForecastDocument:
    crossings = presentation.crossings_document(presentation.limit_crossings(result, LIMITS))
    return forecast_document(result, presentation.limits_document(LIMITS), crossings, None, names)


def test_crossings_are_those_of_the_ensemble(hot_forecast: Forecast) -> None:
    crossings = presentation.limit_crossings(hot_forecast, LIMITS)
    assert set(crossings) == {"t_inner_ring_c", "t_outer_ring_c"}, "a node has no members kept"
    crossing = crossings["t_inner_ring_c"]["warning"]
    assert crossing.probability > 0.5
    assert crossing.earliest_s is not None
    assert crossing.median_s is not None
    assert 0.0 < crossing.earliest_s < crossing.median_s < 7200.0
    assert crossings["t_inner_ring_c"]["alarm"].probability <= crossing.probability


def test_a_forecast_is_plain_json_with_ordered_quantiles(hot_forecast: Forecast) -> None:
    shown = json.loads(shown_of(hot_forecast).to_bytes())
    assert shown["time_s"] == [600.0 * row for row in range(13)]
    assert set(shown["nodes"]) == set(hot_forecast.names)
    for quantiles in shown["nodes"].values():
        columns = [quantiles[name] for name in Quantiles.model_fields]
        assert (np.diff(np.array(columns), axis=0) >= 0).all()
        assert all(len(column) == 13 for column in columns)
    assert shown["limits"]["t_node_7_c"] == {"warning": 60.0, "alarm": 80.0}
    assert set(shown["time_to_limit"]["t_outer_ring_c"]["alarm"]) == {
        "probability",
        "median_s",
        "earliest_s",
    }
    assert shown["labels"] == list(hot_forecast.labels)
    assert set(shown["whole_run"]["factors"]) == set(hot_forecast.sensors)
    assert shown["whole_run"]["level"] == 0.9
    for name, factors in shown["whole_run"]["factors"].items():
        low, median, high = (np.array(shown["nodes"][name][key]) for key in ("q025", "q50", "q975"))
        edges = median - factors * (median - low), median + factors * (high - median)
        assert_allclose(edges, hot_forecast.whole_run(name), rtol=5e-4, atol=0.02)
    assert ForecastDocument.model_validate(shown), "what is not checked when it is built fits, too"


def test_only_the_wanted_nodes_are_shown(hot_forecast: Forecast) -> None:
    shown = shown_of(hot_forecast, ["t_node_3_c", "t_outer_ring_c"])
    assert list(shown.nodes) == ["t_node_3_c", "t_outer_ring_c"]
    assert list(shown.whole_run.factors) == ["t_outer_ring_c"], "a node has no readings"


def test_tags_of_an_estimate_that_has_not_started(estimate: LiveEstimate) -> None:
    tags = presentation.estimate_tags(estimate, BEGAN)
    assert len(tags) == 15
    assert set(map(str, tags)) >= {"t_inner_ring_c.twin", "t_node_13_c.twin"}
    for one in tags.values():
        assert one == {
            "value": None,
            "unit": "°C",
            "quality": int(Quality.WAITING_FOR_INITIAL_DATA),
            "time": BEGAN,
        }
    state = presentation.state_document(estimate, START_US, [])
    assert dict(state.nodes["t_node_1_c"]) == {
        "mean_c": None,
        "std_c": None,
        "known": False,
        "reason": "no estimate yet",
    }
    assert state.time == "2025-11-21T04:40:00.000Z"


def test_tags_and_state_of_a_running_estimate(
    estimate: LiveEstimate, machine_at_rest: dict[str, float]
) -> None:
    estimate.step(START_US, machine_at_rest)
    tag = presentation.estimate_tags(estimate, BEGAN)["t_node_7_c.twin"]
    assert tag["value"] == round(float(estimate.observer.temperatures_c[6]), 3)
    assert tag["quality"] == Quality.GOOD
    assert tag["time"] == "2025-11-21T04:40:00.000Z", "when it held, not when it is asked for"
    state = presentation.state_document(estimate, START_US + 3_000_000, [])
    assert state.time == tag["time"]
    assert state.model_version == 1
    assert dict(state.nodes["t_node_7_c"]) == {
        "mean_c": tag["value"],
        "std_c": round(float(estimate.std_c[6]), 3),
        "known": True,
        "reason": None,
    }


def test_a_node_that_no_sensor_shows_is_not_known_once_the_machine_is_hot(
    estimate: LiveEstimate, machine_at_rest: dict[str, float]
) -> None:
    estimate.step(START_US, machine_at_rest)
    model, hot = estimate.active.model, {"speed_rpm": 6200.0, "load_n": 2650.0, "ambient_c": 22.0}
    rings = {"t_inner_ring_c": 60.0, "t_outer_ring_c": 38.0}
    for minute in range(1, 240):
        estimate.step(START_US + minute * 60_000_000, hot | rings)
    shown = presentation.state_document(estimate, START_US, []).nodes
    tags = presentation.estimate_tags(estimate, BEGAN)
    unknown = {name for name, node in shown.items() if not node.known}
    # Balls, cage and grease; the shaft's far end. Not what the sensors are next to.
    assert {"t_node_3_c", "t_node_6_c", "t_node_7_c", "t_node_12_c"} <= unknown
    assert not unknown & {"t_node_1_c", "t_node_2_c", "t_node_4_c"}
    for name, node in shown.items():
        expected = Quality.UNCERTAIN if name in unknown else Quality.GOOD
        assert tags[f"{name}.twin"]["quality"] == expected
        assert (node.reason is not None) == (name in unknown)
        assert node.std_c is not None, "who wants it still has the figure"
    assert (
        shown["t_node_3_c"].reason
        == f"±{1.96 * (shown['t_node_3_c'].std_c or 0):.0f} K: no sensor shows it"
    )
    sleeve = model.node_names.index("t_node_10_c")
    assert estimate.std_c[sleeve] > 2.0 * estimate.observer.std_c[sleeve], "joints of a sleeve"


def test_forecast_tags_wait_for_the_first_forecast() -> None:
    tags = presentation.forecast_tags(LIMITS, None, BEGAN)
    assert len(tags) == 3 * len(LIMITS)
    for one in tags.values():
        assert one["value"] is None
        assert one["quality"] == Quality.WAITING_FOR_INITIAL_DATA


def test_forecast_tags_show_the_peak_and_the_times(hot_forecast: Forecast) -> None:
    summary = presentation.summarize(hot_forecast, LIMITS, START_US)
    tags = presentation.forecast_tags(LIMITS, summary, "never")
    peak = tags["t_inner_ring_c.forecast_max"]
    medians = [value for value in shown_of(hot_forecast).nodes["t_inner_ring_c"].q50 if value]
    assert peak["value"] == max(medians)
    assert (peak["unit"], peak["quality"]) == ("°C", Quality.GOOD)
    assert peak["time"] == "2025-11-21T04:40:00.000Z"
    to_warning = tags["t_inner_ring_c.time_to_warning_s"]
    crossing = summary.crossings["t_inner_ring_c"]["warning"]
    assert to_warning["value"] == round(crossing.median_s or 0, 6)
    assert to_warning["unit"] == "s"


def test_a_limit_that_will_not_be_exceeded_has_no_time_but_a_good_quality() -> None:
    never = LimitCrossing(0.0, None, None)
    crossings: LimitCrossings = {"t_inner_ring_c": {"warning": never, "alarm": never}}
    summary = ForecastSummary(START_US, {"t_inner_ring_c": 60.0}, crossings)
    tags = presentation.forecast_tags(LIMITS, summary, BEGAN)
    assert tags["t_inner_ring_c.time_to_alarm_s"]["value"] is None
    assert tags["t_inner_ring_c.time_to_alarm_s"]["quality"] == Quality.GOOD


@pytest.mark.parametrize(
    ("value", "shown"),
    [(24.700000000000003, 24.7), (math.nan, None), (-math.inf, None), (None, None), (0.0, 0.0)],
)
def test_a_tag_shows_numbers_only(value: float | None, shown: float | None) -> None:
    assert tag(value, "°C", Quality.GOOD, BEGAN)["value"] == shown


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("t_inner_ring_c", "°C"),
        ("t_node_7_c.twin", "°C"),
        ("ambient_c", "°C"),
        ("speed_setpoint_rpm", "rpm"),
        ("load_n", "N"),
        ("phase", ""),
    ],
)
def test_units_follow_from_names(name: str, unit: str) -> None:
    assert unit_of(name) == unit
