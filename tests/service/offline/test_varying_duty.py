"""A machine that is held nowhere: trained over its range, labels and bands by what the data say."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.virtual_bench import BenchParameters, Scenario, measure, scenario_profile, simulate
from adapters.virtual_bench.scenarios import BenchPhase
from service.offline.model_file import IdentifiedModel
from twin_core.forecasting.labels import LOAD_LAW, SPEED_LAW

from .files import HEADER, Run, read, write

REST_S, STEP_S, STEPS = 180, 120, 100
LOW_S = REST_S + STEPS * STEP_S


@pytest.fixture(scope="module")
def ride() -> Run:
    """Three hours and a half of duty that changes every two minutes, then a heavy stage."""
    rng = np.random.default_rng(2)
    speed, load = 2500.0, 2000.0
    steps = [BenchPhase("at rest", REST_S, 0.0, load, "low")]
    for _ in range(STEPS):
        speed = float(np.clip(speed * np.exp(0.35 * rng.standard_normal()), 1000.0, 4200.0))
        load = float(np.clip(load * np.exp(0.3 * rng.standard_normal()), 1000.0, 3300.0))
        steps.append(BenchPhase("ride", STEP_S, speed, load, "low"))
    steps.append(BenchPhase("heavy", 3600.0, 4200.0, 4600.0, "high"))
    bench = BenchParameters.for_bearing("6311")
    profile = scenario_profile(Scenario("ride", "ride", "6311", tuple(steps)), bench, seed=2)
    truth = simulate(profile, bench)
    shown = measure(profile, truth, seed=2)
    table = np.stack([getattr(shown, name) for name in HEADER], axis=1)
    return Run(table, truth.t_inner_ring_c, truth.t_outer_ring_c)


def test_a_ride_teaches_the_laws_that_its_data_inform(
    ride: Run, tmp_path: Path, command: Callable[..., Any]
) -> None:
    data = write(tmp_path / "data.csv", ride.rows(60, 0, LOW_S))
    model = tmp_path / "model.json"
    found = command(
        "identify", data, "--bearing", "6311", "--at-rest", "--method", "refine", "--out", model,
        "--json",
    )  # fmt: skip
    assert found["parameters"]["b"]["verdict"] == "informed"
    assert "latest" in [check["name"] for check in found["gates"]["checks"]]
    trained = IdentifiedModel.load(model).posterior.trained
    assert trained.load_n_max == pytest.approx(3300.0, rel=0.1)
    assert trained.speed_rpm_max == pytest.approx(4200.0, rel=0.1)
    assert (trained.distinct_loads >= 2, trained.distinct_speeds >= 2) == (True, True)

    ahead = ride.rows(60, LOW_S, len(ride.measured) - 1)
    ahead[:, 0] -= LOW_S
    profile = write(tmp_path / "profile.csv", ahead[:, :4], HEADER[:4])
    out = tmp_path / "forecast.csv"
    answer = command(
        "forecast", model, "--history", data, "--profile", profile, "--out", out, "--json"
    )
    assert not {LOAD_LAW, SPEED_LAW} & set(answer["labels"])
    forecast = read(out)
    for column, name, widest_k in ((4, "t_inner_ring_c", 5.0), (5, "t_outer_ring_c", 2.5)):
        low, high = forecast[f"{name}_q025"], forecast[f"{name}_q975"]
        measured = ahead[:, column]
        assert np.mean((low <= measured) & (measured <= high)) > 0.9, name
        assert (high[-1] - low[-1]) / 2.0 < widest_k, name


def test_a_ride_at_one_load_still_leaves_the_load_law_to_the_prior(
    tmp_path: Path, command: Callable[..., Any]
) -> None:
    """Speeds vary, the load is what a sensor of a constant load shows: the label stays."""
    rng = np.random.default_rng(6)
    steps = [BenchPhase("at rest", REST_S, 0.0, 2000.0, "low")]
    steps += [
        BenchPhase("ride", STEP_S, float(speed), 2000.0, "low")
        for speed in rng.uniform(1000.0, 4200.0, 60)
    ]
    bench = BenchParameters.for_bearing("6311")
    profile = scenario_profile(Scenario("ride", "ride", "6311", tuple(steps)), bench, seed=6)
    truth = simulate(profile, bench)
    shown = measure(profile, truth, seed=6)
    table = np.stack([getattr(shown, name) for name in HEADER], axis=1)
    run = Run(table, truth.t_inner_ring_c, truth.t_outer_ring_c)
    rows = run.rows(60, 0, len(table) - 60)
    data, model = write(tmp_path / "data.csv", rows), tmp_path / "model.json"
    command(
        "identify", data, "--bearing", "6311", "--at-rest", "--method", "refine", "--out", model
    )
    trained = IdentifiedModel.load(model).posterior.trained
    assert (trained.distinct_loads, trained.distinct_speeds >= 2) == (1, True)
    planned = np.array([[0.0, 3000.0, 2900.0, 22.0], [3600.0, 3000.0, 2900.0, 22.0]])
    ahead = write(tmp_path / "profile.csv", planned, HEADER[:4])
    answer = command(
        "forecast", model, "--history", data, "--profile", ahead, "--out", tmp_path / "f.csv",
        "--json",
    )  # fmt: skip
    assert LOAD_LAW in answer["labels"]
    assert SPEED_LAW not in answer["labels"]
