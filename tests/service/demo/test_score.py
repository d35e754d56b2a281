"""Which forecast is scored, and how."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.clock import rfc3339
from service.demo.score import (
    SENSORS,
    MeasuredMinutes,
    ScoredForecast,
    Stage,
    ended,
    made_before,
    stage_account,
)
from service.documents.forecasts import LiveForecast, Quantiles, WholeRun

START_US = 1_763_700_000_000_000
MINUTE_US = 60_000_000
STAGE = Stage("6200 rpm", "high", 6200.0, 2650.0, START_US, START_US + 60 * MINUTE_US)
NO_WARNING = {"forecast_limit_at": None, "measured_limit_at": None}


def forecast(
    made_min: float, hours: float = 4.0, version: int = 2, level_c: float = 50.0
) -> ScoredForecast:
    """A forecast made so many minutes after the stage began: rising by 0.1 K per minute, ± 2 K."""
    made_us = START_US + round(made_min * MINUTE_US)
    time_s = np.arange(0.0, hours * 3600.0 + 1, 60.0)
    median = level_c + time_s / 600.0
    quantiles = {"q025": median - 2.0, "q25": median, "q50": median, "q75": median,
                 "q975": median + 2.0}  # fmt: skip
    return ScoredForecast.of(
        LiveForecast(
            made_at=rfc3339(made_us),
            intervals_made_at=rfc3339(made_us),
            planned=True,
            model_version=version,
            time_s=time_s.tolist(),
            nodes={
                sensor: Quantiles(**{name: values.tolist() for name, values in quantiles.items()})
                for sensor in SENSORS
            },
            not_known={},
            limits={},
            time_to_limit={},
            labels=[],
            whole_run=WholeRun(level=0.9, factors={}),
            runaway_probability=0.0,
            profile=[],
            missing=[],
        )
    )


def measured(*temperatures_c: float) -> dict[str, MeasuredMinutes]:
    """Minute means of both rings from the stage's start on."""
    times = START_US + MINUTE_US * (0.5 + np.arange(len(temperatures_c)))
    values = np.array(temperatures_c, dtype=np.float64)
    return {sensor: MeasuredMinutes(times.astype(np.float64), values) for sensor in SENSORS}


def test_the_latest_forecast_before_the_start_is_scored() -> None:
    early, late = forecast(-30), forecast(-1)
    assert made_before([early, late, forecast(0), forecast(10)], STAGE) is late


def test_a_forecast_made_at_the_start_or_in_the_stage_is_not_scored() -> None:
    assert made_before([forecast(0), forecast(10)], STAGE) is None
    assert made_before([], STAGE) is None


def test_a_forecast_that_does_not_reach_the_end_is_not_scored() -> None:
    short, long = forecast(-1, hours=0.5), forecast(-20)
    assert made_before([long, short], STAGE) is long
    assert made_before([short], STAGE) is None


def test_a_forecast_of_the_time_in_which_the_bench_waited_is_moved_to_the_start() -> None:
    """Its plan takes the stage to begin at once: seven minutes later all of it is seven later."""
    planned, waiting = forecast(-20), forecast(-7)
    waited_from_us = START_US - 10 * MINUTE_US
    moved = made_before([planned, waiting], STAGE, waited_from_us)
    assert moved is not None
    assert moved.made_at_us == waiting.made_at_us
    assert moved.time_us[0] == START_US
    assert made_before([planned], STAGE, waited_from_us) is planned


def test_a_stage_under_way_needs_only_its_start() -> None:
    running = Stage("6200 rpm", "high", 6200.0, 2650.0, START_US, None)
    short = forecast(-1, hours=0.1)
    assert made_before([short], running) is short


def test_point_values_are_those_at_the_end() -> None:
    made = forecast(-10)  # 51.05 °C is forecast for the stage's first half minute
    shown = stage_account(STAGE, made, measured(51.0, 51.0, 52.0), NO_WARNING)
    assert (shown["name"], shown["risk"]) == ("6200 rpm", "high")
    assert (shown["speed_rpm"], shown["load_n"]) == (6200.0, 2650.0)
    assert shown["start"] < shown["end"]
    assert shown["forecast_made_at"] < shown["start"]
    assert shown["forecast_model_version"] == 2
    assert set(shown["sensors"]) == set(SENSORS)
    assert shown["sensors"]["t_inner_ring_c"] == {
        "forecast_c": 51.25,
        "q025": 49.25,
        "q975": 53.25,
        "measured_c": 52.0,
        "error_c": -0.75,
        "inside_95": True,
        "max_error_c": 0.75,
        "coverage_95": 1.0,
    }


def test_coverage_counts_every_minute_and_the_largest_error_any() -> None:
    row = stage_account(STAGE, forecast(-10), measured(60.0, 51.0, 51.0, 51.0), NO_WARNING)[
        "sensors"
    ]["t_outer_ring_c"]
    assert row["coverage_95"] == 0.75
    assert row["max_error_c"] == pytest.approx(60.0 - 51.05, abs=0.006)
    assert row["inside_95"] is True, "that is said of the end alone"
    stage = stage_account(STAGE, forecast(-10), measured(51.0, 60.0), NO_WARNING)
    row = stage["sensors"]["t_outer_ring_c"]
    assert (row["coverage_95"], row["inside_95"]) == (0.5, False)


def test_without_a_forecast_its_figures_are_null() -> None:
    shown = stage_account(STAGE, None, measured(51.0, 52.0), NO_WARNING)
    assert shown["forecast_made_at"] is None
    assert shown["forecast_model_version"] is None
    row: dict[str, Any] = shown["sensors"]["t_inner_ring_c"]
    assert row.pop("measured_c") == 52.0
    assert set(row) == {
        "forecast_c", "q025", "q975", "error_c", "inside_95", "max_error_c", "coverage_95",
    }  # fmt: skip
    assert set(row.values()) == {None}


@pytest.mark.parametrize("nothing", [{}, measured()])
def test_without_measurements_all_figures_are_null(nothing: dict[str, MeasuredMinutes]) -> None:
    shown = stage_account(STAGE, forecast(-10), nothing, NO_WARNING)
    assert shown["forecast_made_at"] is not None
    assert set(shown["sensors"]["t_inner_ring_c"].values()) == {None}


def test_a_stage_under_way_has_no_end() -> None:
    running = Stage("6200 rpm", "high", 6200.0, 2650.0, START_US, None)
    assert stage_account(running, None, {}, NO_WARNING)["end"] is None


def test_a_stage_ends_where_it_was_planned_to_however_long_the_bench_waits() -> None:
    """Three hours of waiting lie outside every forecast; the stage itself was foreseen."""
    running = replace(STAGE, end_us=None)
    assert ended(running, START_US + 59 * MINUTE_US, 3600.0).end_us == START_US + 59 * MINUTE_US
    waited = ended(running, START_US + 240 * MINUTE_US, 3600.0)
    assert waited.end_us == START_US + 60 * MINUTE_US
    kept = [forecast(-5.0, hours=2.0)]
    assert made_before(kept, waited) is kept[0]
