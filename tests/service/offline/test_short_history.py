"""Forecasts of a warm machine from ten seconds to an hour of history.

How warm a body without a sensor is can only be guessed from seconds of one. The guess must say how
wide it is: what really comes lies in the band from the first row on.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from own_networks import MOTOR
from site_files import COLUMNS, asset_text

from service.site.machines.machine import Machine
from service.site.machines.networks import read_network
from twin_core.simulation import OperatingProfile, simulate

from .files import HEADER, LOW_S, Run, read, write

CONFIGURATION = asset_text(
    "motor-1", ("t_winding_c", *COLUMNS), machine='network = "motor.toml"', low_risk=(6000, 8000)
)
MOTOR_HEADER = ("time_s", "speed_rpm", "load_n", "ambient_c", "t_winding_c", "t_body_c")
STEP_S, NOW_S, AHEAD_S = 2, 3 * 3600, 3600
HISTORIES_S = (10, 60, 600, 3600)


@pytest.fixture(scope="module")
def driving(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """Four hours of driving, all temperatures; full torque for two minutes up to three hours."""
    file = tmp_path_factory.mktemp("driving") / "motor.toml"
    file.write_text(MOTOR)
    model = Machine("default", None, read_network(file)).build()
    rng = np.random.default_rng(12)
    time_s = np.arange(0.0, NOW_S + AHEAD_S + 1.0, STEP_S)
    blocks = (time_s // 20.0).astype(int)
    load = (1500.0 * np.exp(0.8 * rng.standard_normal(blocks[-1] + 1)))[blocks].clip(0.0, 6000.0)
    speed = (2500.0 * np.exp(0.4 * rng.standard_normal(blocks[-1] + 1)))[blocks].clip(0.0, 5000.0)
    burst = (time_s >= NOW_S - 120.0) & (time_s < NOW_S)
    load[burst], speed[burst] = 6000.0, 5000.0
    profile = OperatingProfile(time_s, speed, load, np.full(time_s.size, 22.0))
    values = model.parameters.centre * [1.15, 0.85, 1.2, 0.9]
    truth = simulate(model, values, profile, np.full(2, 22.0)).temperatures_c
    read_c = truth[:, :1] + 0.05 * rng.standard_normal((time_s.size, 1))
    return np.concatenate(
        [np.stack([time_s, speed, load, profile.ambient_c], axis=1), read_c, truth[:, 1:]], axis=1
    )


@pytest.fixture(scope="module")
def motor(
    tmp_path_factory: pytest.TempPathFactory, driving: np.ndarray, run_command: Callable[..., Any]
) -> Path:
    """Identified from the first two hours, the body without a sensor."""
    folder = tmp_path_factory.mktemp("motor")
    (folder / "motor.toml").write_text(MOTOR)
    (folder / "twin.toml").write_text(CONFIGURATION)
    low = write(folder / "low.csv", driving[driving[:, 0] <= 7200.0, :5], MOTOR_HEADER[:5])
    model = folder / "model.json"
    run_command(
        "identify", low, "--config", folder / "twin.toml", "--asset", "motor-1", "--at-rest",
        "--method", "refine", "--out", model,
    )  # fmt: skip
    return model


def inside(forecast: dict[str, np.ndarray], name: str, truth_c: np.ndarray) -> np.ndarray:
    return np.asarray((forecast[f"{name}_q025"] <= truth_c) & (truth_c <= forecast[f"{name}_q975"]))


@pytest.mark.parametrize("history_s", HISTORIES_S)
def test_a_body_without_a_sensor_lies_in_its_band_from_the_first_row(
    history_s: int,
    motor: Path,
    driving: np.ndarray,
    tmp_path: Path,
    command: Callable[..., Any],
) -> None:
    time_s = driving[:, 0]
    known = driving[(time_s >= NOW_S - history_s) & (time_s <= NOW_S)]
    history = write(tmp_path / "history.csv", known[:, :5], MOTOR_HEADER[:5])
    ahead = driving[time_s >= NOW_S].copy()
    ahead[:, 0] -= NOW_S
    profile = write(tmp_path / "profile.csv", ahead[:, :4], HEADER[:4])
    told = command(
        "forecast", motor, "--history", history, "--profile", profile,
        "--out", tmp_path / "forecast.csv", "--json",
    )  # fmt: skip
    forecast = read(tmp_path / "forecast.csv")
    for name, truth_c in (("t_winding_c", ahead[:, 4]), ("t_body_c", ahead[:, 5])):
        held = inside(forecast, name, truth_c)
        assert held[0], (name, truth_c[0], [forecast[f"{name}_q{q}"][0] for q in ("025", "975")])
        assert np.mean(held) > 0.9, name
    # What the history does not tell is said, and becomes less with every minute.
    spread = told["initial_state"]["t_body_c"]["half_width_k"]
    width = forecast["t_body_c_q975"][0] - forecast["t_body_c_q025"][0]
    assert spread == pytest.approx(width / 2.0, rel=0.35)
    said = [label for label in told["labels"] if label.startswith("initial state of t_body_c")]
    if history_s <= 60:
        assert spread > 5.0
        assert said == [f"initial state of t_body_c known to ±{spread:.0f} K only"]
    if history_s == 3600:
        assert spread < 30.0
        assert said == []


@pytest.mark.parametrize("history_s", HISTORIES_S)
def test_the_rings_of_a_warm_bearing_lie_in_their_bands_from_the_first_row(
    history_s: int, run: Run, bearing_model: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    """The bench has run for two hours when the history begins or ends; ahead is a faster stage."""
    rows = run.rows(2 if history_s < 3600 else 60, LOW_S - history_s, LOW_S)
    history = write(tmp_path / "history.csv", rows)
    ahead = run.rows(60, LOW_S, len(run.measured) - 1)
    ahead[:, 0] -= LOW_S
    profile = write(tmp_path / "profile.csv", ahead[:, :4], HEADER[:4])
    told = command(
        "forecast", bearing_model, "--history", history, "--profile", profile,
        "--out", tmp_path / "forecast.csv", "--json",
    )  # fmt: skip
    forecast = read(tmp_path / "forecast.csv")
    for name, column in (("t_inner_ring_c", 4), ("t_outer_ring_c", 5)):
        held = inside(forecast, name, ahead[:, column])
        assert held[0], name
        assert np.mean(held) > 0.9, (name, np.mean(held))
    assert set(told["initial_state"]) >= {"t_inner_ring_c", "t_outer_ring_c", "t_node_5_c"}
