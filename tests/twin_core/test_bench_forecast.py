"""From low-risk data of the virtual bench to its high-risk stages: does the twin forecast them?

The bench's physics share nothing with the twin's. Identified from one demo run's first five hours
(up to 4200 rpm, 2000 to 3300 N), the twin forecasts 6200 rpm at 2650 N and then at 5500 N.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from adapters.virtual_bench import (
    BenchParameters,
    find_scenario,
    measure,
    scenario_profile,
    simulate,
)
from twin_core import scores
from twin_core.bearings import bearing
from twin_core.forecasting import Forecast, forecast
from twin_core.forecasting.labels import RUNAWAY
from twin_core.identification import (
    FitSettings,
    IdentificationData,
    IdentificationResult,
    IdentificationWindow,
    identify,
    prior_posterior,
)
from twin_core.identification.gates import GateReport, judge
from twin_core.initial_state import initial_state
from twin_core.models import build_model
from twin_core.naive import fit_naive
from twin_core.observer import Observer
from twin_core.simulation import OperatingProfile
from twin_core.windows import LowRiskRegion, MinuteData, find_windows

SENSORS = ("t_inner_ring_c", "t_outer_ring_c")
REGION = LowRiskRegion(speed_rpm_max=4300.0, load_n_max=3400.0)
FAST_MIN, HEAVY_MIN = 75, 75


@dataclass(frozen=True)
class Story:
    """One run: its minutes, what was found in the low part, what was forecast for the high part."""

    minutes: MinuteData
    truth: dict[str, NDArray[np.float64]]
    low: MinuteData
    result: IdentificationResult
    report: GateReport
    ahead: OperatingProfile
    forecast: Forecast
    first: int


def run_bench(parameters: BenchParameters, seed: int) -> tuple[MinuteData, dict[str, NDArray]]:
    """Minute rows of the demo as the service makes them from the store."""
    profile = scenario_profile(find_scenario("demo"), parameters, seed)
    run = simulate(profile, parameters)
    seen = measure(profile, run, seed)
    count = profile.time_s.size // 60

    def over(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(values[: 60 * count].reshape(count, 60).mean(axis=1))

    def around(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array([values[max(60 * k - 30, 0) : 60 * k + 30].mean() for k in range(count)])

    minutes = MinuteData(
        60.0 * np.arange(count, dtype=np.float64),
        over(seen.speed_rpm),
        over(seen.load_n),
        over(seen.ambient_c),
        {
            "t_inner_ring_c": around(seen.t_inner_ring_c),
            "t_outer_ring_c": around(seen.t_outer_ring_c),
        },
        np.ones(count, dtype=np.bool_),
    )
    nodes = {f"t_node_{k + 1}_c": values for k, values in enumerate(run.paper_nodes_c.T)}
    rings = {"t_inner_ring_c": run.t_inner_ring_c, "t_outer_ring_c": run.t_outer_ring_c}
    return minutes, {name: values[: 60 * count : 60] for name, values in {**rings, **nodes}.items()}


def observe(model, z, minutes: MinuteData, rows: int) -> Observer:  # type: ignore[no-untyped-def]
    values = model.parameters.values_from_z(z)
    readings = [
        {name: float(minutes.temperatures_c[name][row]) for name in SENSORS} for row in range(rows)
    ]
    mean, covariance = initial_state(
        model, values, readings[0], float(minutes.ambient_c[0]), 0.0, 0.0, True
    )
    observer = Observer(model, values, mean, covariance)
    for row in range(rows - 1):
        observer.predict(
            60.0,
            float(minutes.speed_rpm[row]),
            float(minutes.load_n[row]),
            float(minutes.ambient_c[row]),
        )
        observer.update(readings[row + 1])
    return observer


@pytest.fixture(scope="module", params=[None, 2], ids=["default bench", "random bench"])
def story(request: pytest.FixtureRequest) -> Story:
    seed = request.param
    parameters = (
        BenchParameters.for_bearing("6311") if seed is None else BenchParameters.random(seed)
    )
    minutes, truth = run_bench(parameters, seed or 0)
    model = build_model(bearing=bearing("6311"))
    first_window = find_windows(minutes, REGION)[0]
    low = minutes.between(first_window.start_s, first_window.end_s)
    data = IdentificationData((IdentificationWindow(low, first_window.at_rest),))
    result = identify(model, data, FitSettings(seed=1))
    report = judge(model, data, result, active=prior_posterior(model))
    first = low.size - 1
    observer = observe(model, result.posterior.z, minutes, first + 1)
    rows = slice(first, first + FAST_MIN + HEAVY_MIN + 1)
    # The plan as a controller gives it: set-points, and the ambient of now.
    after = np.arange(FAST_MIN + HEAVY_MIN + 1)
    ahead = OperatingProfile(
        minutes.time_s[rows] - minutes.time_s[first],
        np.where(after == 0, 4200.0, 6200.0),
        np.where(after <= FAST_MIN, 2650.0, 5500.0),
        np.full(after.size, minutes.ambient_c[first]),
    )
    made = forecast(
        model,
        result.posterior,
        observer.state(),
        ahead,
    )
    return Story(minutes, truth, low, result, report, ahead, made, first)


def test_only_the_low_risk_part_was_used_and_the_gates_let_it_pass(story: Story) -> None:
    assert story.low.size == 3 + 295
    assert story.low.speed_rpm.max() < 4250.0
    assert story.result.status == "converged"
    assert story.result.posterior.trained.from_rest
    assert story.report.accepted, story.report.reason


@pytest.mark.parametrize("name", SENSORS)
def test_high_risk_stages_are_forecast_within_their_bands(story: Story, name: str) -> None:
    rows = slice(story.first, story.first + story.ahead.size)
    measured, truth = story.minutes.temperatures_c[name][rows], story.truth[name][rows]
    quantiles = story.forecast.quantile(name)
    assert abs(quantiles[2, FAST_MIN] - truth[FAST_MIN]) < 2.0
    assert abs(quantiles[2, -1] - truth[-1]) < 2.7
    assert scores.coverage(quantiles[0], quantiles[4], measured) >= 0.85
    # Honest, but of use: half a band at 5500 N is far from the step of some 20 K itself.
    assert quantiles[4, -1] - quantiles[0, -1] < 20.0


def test_the_bands_cover_what_is_measured(story: Story) -> None:
    rows = slice(story.first, story.first + story.ahead.size)
    shares = [
        scores.coverage(quantiles[0], quantiles[4], story.minutes.temperatures_c[name][rows])
        for name in SENSORS
        for quantiles in [story.forecast.quantile(name)]
    ]
    assert np.mean(shares) >= 0.93


def test_a_node_without_a_sensor_is_near_the_truth_or_said_to_be_not_known(story: Story) -> None:
    made = story.forecast
    fast = slice(story.first, story.first + FAST_MIN + 1)
    nodes = [name for name in made.names if name not in made.sensors]
    for name in nodes:
        low, _, median, _, high = made.quantile(name)[:, : FAST_MIN + 1]
        assert scores.coverage(low, high, story.truth[name][fast]) >= 0.93, name
        if name not in made.not_known:
            assert abs(np.mean(median - story.truth[name][fast])) <= 2.0, name
    # Housing, rings and end caps are of use; balls, cage, grease and the far shaft are not.
    assert {f"t_node_{k}_c" for k in (3, 6, 7, 12)} <= set(made.not_known)
    assert not {f"t_node_{k}_c" for k in (1, 2, 4, 8, 9)} & set(made.not_known)


def test_the_twin_beats_every_naive_forecast(story: Story) -> None:
    """On both sensors together; on the outer ring alone ARX can be as good by luck."""
    rows = slice(story.first, story.first + story.ahead.size)
    measured = np.concatenate([story.minutes.temperatures_c[name][rows] for name in SENSORS])
    last = {sensor: float(story.low.temperatures_c[sensor][-1]) for sensor in SENSORS}
    medians = np.concatenate([story.forecast.quantile(name)[2] for name in SENSORS])
    naive = fit_naive([story.low]).forecast(story.ahead, last)
    for kind, by_sensor in naive.items():
        path = np.concatenate([by_sensor[name] for name in SENSORS])
        assert scores.rms(medians, measured) < 0.7 * scores.rms(path, measured), kind


def test_a_warning_comes_long_before_the_limit_is_reached(story: Story) -> None:
    """A limit that the heavy stage reaches half an hour after its start is foreseen at the start
    of the fast stage, with a crossing time that is right within the quarter of an hour.
    """
    rows = slice(story.first, story.first + story.ahead.size)
    truth = story.truth["t_inner_ring_c"][rows]
    limit_c = float(truth[FAST_MIN + 30])
    crossing = story.forecast.exceedance("t_inner_ring_c", limit_c)
    assert crossing.probability > 0.5
    assert crossing.median_s == pytest.approx(60.0 * (FAST_MIN + 30), abs=900.0)
    assert crossing.earliest_s is not None
    assert crossing.earliest_s <= 60.0 * (FAST_MIN + 30)
    assert RUNAWAY not in story.forecast.labels  # none of these benches runs away
