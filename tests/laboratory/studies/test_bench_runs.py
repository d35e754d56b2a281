"""Bench runs as the twin sees them, its forecast and the scores."""

import numpy as np
import pytest

from adapters.virtual_bench import BenchParameters
from bearing_twin_laboratory.studies.bench_runs import (
    NODES,
    RINGS,
    BenchRun,
    FloatArray,
    Stage,
    Twin,
    forecast_from,
    identify_twin,
    run_bench,
)
from bearing_twin_laboratory.studies.bench_scores import (
    beside,
    figures,
    node_coverage,
    node_errors,
    score_rings,
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


@pytest.mark.parametrize("name", RINGS)
def test_scores_are_those_of_the_scored_rows(run: BenchRun, made: Forecast, name: str) -> None:
    found = score_rings(made, run, LAST, LAST + 1, 120)[name]
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


def test_steady_are_the_last_half_hours_of_all_stages(run: BenchRun) -> None:
    steady = run.steady(30, 120)
    assert np.flatnonzero(steady).tolist() == [
        *range(10),
        *range(20, 50),
        *range(60, 90),
    ]
    assert np.flatnonzero(run.steady(80, 100)).tolist() == list(range(20))


def test_the_forecast_is_far_better_than_none(run: BenchRun, twin: Twin, made: Forecast) -> None:
    assert twin.may_forecast
    found = score_rings(made, run, LAST, LAST + 1, 120)
    for name in RINGS:
        assert found[name].max_error_k < 0.5 * np.ptp(run.truth_c[name][LAST:])
        assert found[name].coverage_95 > 0.8
    ahead = run.measured(LAST, 120)
    rows, late = beside(twin, run, made, ahead, LAST, [(LAST + 1, 120), (110, 120)])
    by_key = {(row.method, row.sensor): row for row in rows}
    for name in RINGS:
        own = by_key["twin", name]
        assert own.rms_k == pytest.approx(found[name].rms_error_k)
        assert own.max_error_k == pytest.approx(found[name].max_error_k)
        assert own.coverage == found[name].coverage_95
        assert own.rms_k < by_key["persistence", name].rms_k
    by_key = {(row.method, row.sensor): row for row in late}
    for name, expected in score_rings(made, run, LAST, 110, 120).items():
        assert by_key["twin", name].rms_k == pytest.approx(expected.rms_error_k)


def test_nodes_are_scored_against_the_benchs_own(run: BenchRun, made: Forecast) -> None:
    errors = node_errors(made, run, LAST, 100, 120)
    assert errors.shape == (13, 20)
    expected = made.quantile("t_node_12_c")[2, 100 - LAST :] - run.truth_c["t_node_12_c"][100:]
    assert np.array_equal(errors[11], expected)
    covered = node_coverage(made, run, LAST, 100, 120)
    assert covered.shape == (13,)
    assert ((covered >= 0.0) & (covered <= 1.0)).all()


def test_figures_over_benches(run: BenchRun, made: Forecast) -> None:
    whole = score_rings(made, run, LAST, LAST + 1, 120)
    late = score_rings(made, run, LAST, 110, 120)
    both = figures([whole, late])
    assert both["benches"] == 2
    for ring in RINGS:
        values = [one[ring].max_error_k for one in (whole, late)]
        assert both["max_error_c"][ring] == pytest.approx(np.mean(values))
        assert both["worst_max_error_c"][ring] == max(values)
        shares = [one[ring].coverage_95 for one in (whole, late)]
        assert both["worst_coverage_95"][ring] == min(shares)
        assert both["benches_covered_below_80_percent"][ring] == sum(x < 0.8 for x in shares)
    none = figures([])
    assert none["benches"] == 0
    assert none["coverage_95"] is None
    assert none["max_error_c"] == dict.fromkeys(RINGS)


@pytest.mark.parametrize(
    ("course", "ran_away"),
    [
        (90.0 + 10.0 * (1.0 - np.exp(-np.arange(40) / 8.0)), False),
        (60.0 + 0.09 * np.arange(40), False),
        (60.0 + 0.01 * np.arange(40) ** 2, True),
        (np.where(np.arange(40) == 5, 110.5, 60.0), True),
    ],
    ids=["settling", "slow", "on its way", "passed 110"],
)
def test_a_bench_that_passes_110_degrees_or_accelerates_has_run_away(
    run: BenchRun, course: FloatArray, ran_away: bool
) -> None:
    truth = run.truth_c["t_inner_ring_c"].copy()
    truth[80:] = course
    one = BenchRun(run.bearing, run.stages, run.minutes, {"t_inner_ring_c": truth})
    assert one.ran_away(80, 120) is ran_away
    assert not one.ran_away(0, 80)
