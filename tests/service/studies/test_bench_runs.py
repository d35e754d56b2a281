"""Bench runs as the twin sees them, its forecast and the scores."""

import numpy as np
import pytest

from adapters.virtual_bench import BenchParameters
from service.studies.bench_runs import (
    NODES,
    RINGS,
    BenchRun,
    Stage,
    Twin,
    forecast_from,
    identify_twin,
    run_bench,
    score,
)
from twin_core import scores
from twin_core.forecasting import Forecast

STAGES = (Stage(40, 1500.0, 2650.0), Stage(40, 3000.0, 2650.0), Stage(40, 4200.0, 3000.0))
LAST = 79


@pytest.fixture(scope="module")
def run() -> BenchRun:
    return run_bench(BenchParameters.random(100), STAGES, 100, node_sensors=True)


@pytest.fixture(scope="module")
def twin(run: BenchRun) -> Twin:
    return identify_twin(run, LAST + 1)


@pytest.fixture(scope="module")
def made(run: BenchRun, twin: Twin) -> Forecast:
    return forecast_from(twin, run, LAST, run.measured(LAST, 120))


def test_rows_are_minutes_from_a_cold_start(run: BenchRun) -> None:
    minutes = run.minutes
    assert minutes.time_s.tolist() == [60.0 * row for row in range(120)]
    assert [run.first_row(stage) for stage in range(4)] == [0, 40, 80, 120]
    # An operating point holds from its row's time on; ramps are part of the minute's mean.
    assert minutes.speed_rpm[39] == pytest.approx(1500.0, abs=1.0)
    assert 2800.0 < minutes.speed_rpm[40] < 2990.0
    assert minutes.speed_rpm[41] == pytest.approx(3000.0, abs=1.0)
    assert minutes.load_n[90] == pytest.approx(3000.0, abs=60.0)
    assert set(minutes.temperatures_c) == {*RINGS, *NODES}
    assert set(run.truth_c) == {*RINGS, *NODES}
    for name in RINGS:
        assert minutes.temperatures_c[name][0] == pytest.approx(minutes.ambient_c[0], abs=0.7)
        assert np.abs(minutes.temperatures_c[name] - run.truth_c[name]).max() < 1.0
    assert run.truth_c["t_inner_ring_c"][-1] > run.truth_c["t_node_13_c"][-1] + 5.0


def test_same_seed_same_run_other_seed_other_bench(run: BenchRun) -> None:
    again = run_bench(BenchParameters.random(100), STAGES, 100)
    assert np.array_equal(again.truth_c["t_node_7_c"], run.truth_c["t_node_7_c"])
    for name in RINGS:
        assert np.array_equal(again.minutes.temperatures_c[name], run.minutes.temperatures_c[name])
    assert set(again.minutes.temperatures_c) == set(RINGS)
    other = run_bench(BenchParameters.random(101), STAGES, 101)
    assert abs(other.truth_c["t_inner_ring_c"][-1] - run.truth_c["t_inner_ring_c"][-1]) > 0.2


def test_the_plan_knows_set_points_and_the_ambient_of_now(run: BenchRun) -> None:
    planned = run.planned(LAST, 120)
    assert planned.time_s[0] == 0.0
    assert planned.speed_rpm.tolist() == [3000.0] + 40 * [4200.0]
    assert planned.load_n.tolist() == [2650.0] + 40 * [3000.0]
    assert set(planned.ambient_c.tolist()) == {run.minutes.ambient_c[LAST]}
    measured = run.measured(LAST, 120)
    assert measured.ambient_c.tolist() == run.minutes.ambient_c[LAST:].tolist()
    assert np.abs(measured.speed_rpm - planned.speed_rpm)[2:].max() < 25.0


def test_what_comes_later_is_unknown_to_twin_and_forecast(
    run: BenchRun, twin: Twin, made: Forecast
) -> None:
    later = run.minutes.take(slice(0, 120))
    spoiled = {
        name: np.where(np.arange(120) > LAST, 999.0, values)
        for name, values in later.temperatures_c.items()
    }
    broken = BenchRun(
        run.bearing,
        run.stages,
        type(later)(
            later.time_s, later.speed_rpm, later.load_n, later.ambient_c, spoiled, later.good
        ),
        {},
    )
    other = identify_twin(broken, LAST + 1)
    assert np.array_equal(other.posterior.z, twin.posterior.z)
    again = forecast_from(other, broken, LAST, run.measured(LAST, 120))
    assert np.array_equal(again.quantiles, made.quantiles)


def test_scores_are_those_of_the_scored_rows(run: BenchRun, twin: Twin, made: Forecast) -> None:
    assert twin.may_forecast
    name = "t_inner_ring_c"
    found = score(made, run, name, LAST, LAST + 1, 120)
    low, _, median, _, high = made.quantile(name)[:, 1:]
    error = median - run.truth_c[name][80:]
    readings = run.minutes.temperatures_c[name][80:]
    assert found.max_error_k == pytest.approx(np.abs(error).max())
    assert found.rise_max_k == pytest.approx(np.abs(error[:10]).max())
    assert found.steady_error_k == pytest.approx(np.abs(error[10:]).mean())
    assert found.steady_bias_k == pytest.approx(error[10:].mean())
    assert found.coverage_95 == scores.coverage(low, high, readings)
    assert found.coverage_95 == pytest.approx(
        (10 * found.rise_coverage_95 + 30 * found.steady_coverage_95) / 40
    )
    assert found.half_width_k == pytest.approx(0.5 * (high - low).mean())
    # From 3000 to 4200 rpm the twin is far better than half of the temperature's own rise.
    assert found.max_error_k < 0.5 * np.ptp(run.truth_c[name][LAST:])
    assert found.coverage_95 > 0.8


def test_a_bench_that_passes_110_degrees_has_run_away(run: BenchRun) -> None:
    hot = dict(run.truth_c)
    hot["t_inner_ring_c"] = hot["t_inner_ring_c"].copy()
    hot["t_inner_ring_c"][100] = 110.5
    one = BenchRun(run.bearing, run.stages, run.minutes, hot)
    assert one.ran_away(80, 120)
    assert not one.ran_away(0, 100)
    assert not run.ran_away(0, 120)
