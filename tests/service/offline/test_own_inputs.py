"""A motor with losses and a coolant, from CSV files: identify, forecast, refuse."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from patience import patience

from service.offline.rows import rows_of_recording, step_of
from service.offline.tables import TableError, read_profile, read_recording
from service.site.machines.machine import Machine
from service.site.machines.networks import read_network
from twin_core.minute_rows import row_step_s

FloatArray = NDArray[np.float64]

NETWORK = """
[parameters]
winding = { unit = "J/K", centre = 200.0, spread = 0.5 }
slot = { unit = "K/W", centre = 0.15, spread = 0.5 }
jacket = { unit = "K/W", centre = 0.2, spread = 0.5 }
r20 = { unit = "ohm", centre = 0.05, spread = 0.5 }

[nodes]
t_winding_c = { capacity_j_k = "winding" }
t_body_c = { capacity_j_k = 2000 }

[[edges]]
between = ["t_winding_c", "t_body_c"]
kind = "constant"
resistance_k_w = "slot"

[[edges]]
between = ["t_body_c", "coolant_c"]
kind = "constant"
resistance_k_w = "jacket"

[[edges]]
between = ["t_body_c", "ambient"]
kind = "constant"
resistance_k_w = 1.0

[[losses]]
node = "t_winding_c"
kind = "copper"
channel = "current_a"
resistance_20_ohm = "r20"

[sensors]
t_winding_c = "t_winding_c"
t_body_c = "t_body_c"

[reference]
inputs = { current_a = 40.0 }
"""
SITE = """
[[assets]]
id = "motor-1"
network = "motor.toml"
low_risk = { speed_rpm_max = 3000, load_n_max = 1 }
channels = { t_winding_c = { source = "push" } }
"""
TRUE = {"winding": 150.0, "slot": 0.1, "jacket": 0.3, "r20": 0.06}
HEADER = ("time_s", "current_a", "coolant_c", "ambient_c", "t_winding_c", "t_body_c")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("motor")
    (folder / "motor.toml").write_text(NETWORK)
    (folder / "site.toml").write_text(SITE)
    return folder


def run(current_a: FloatArray, coolant_c: FloatArray, step_s: float = 1.0) -> FloatArray:
    """Columns of a motor by Heun's method, from the laws as the documentation has them."""
    rows = np.empty((current_a.size, 6))
    winding = body = 22.0
    for k, (current, coolant) in enumerate(zip(current_a, coolant_c, strict=True)):
        rows[k] = k * step_s, current, coolant, 22.0, winding, body

        def rates(w: float, b: float, i: float = current, c: float = coolant) -> tuple[float, ...]:
            heat = TRUE["r20"] * (1.0 + 0.00393 * (w - 20.0)) * i * i
            through = (w - b) / TRUE["slot"]
            out = (b - c) / TRUE["jacket"] + (b - 22.0) / 1.0
            return (heat - through) / TRUE["winding"], (through - out) / 2000.0

        first = rates(winding, body)
        second = rates(winding + step_s * first[0], body + step_s * first[1])
        winding += 0.5 * step_s * (first[0] + second[0])
        body += 0.5 * step_s * (first[1] + second[1])
    return rows


def write(path: Path, rows: FloatArray, header: tuple[str, ...] = HEADER) -> Path:
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header, *np.round(rows, 4).tolist()])
    return path


def duty(seconds: int, low: float, high: float, seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    current = np.repeat(rng.uniform(low, high, seconds // 60 + 1), 60)[:seconds]
    current[:60] = 0.0
    coolant = 22.0 + 8.0 * np.clip(np.arange(seconds) / 600.0, 0.0, 1.0)
    return current, coolant


def bearing_twin(folder: Path, *arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "service", *arguments],
        cwd=folder, capture_output=True, text=True, timeout=patience(280), check=False,
    )  # fmt: skip


@pytest.mark.wires
def test_learned_at_low_current_it_forecasts_a_high_one(folder: Path) -> None:
    noise = np.random.default_rng(9)
    learned = run(*duty(2400, 20.0, 50.0, 1))
    learned[:, 4:] += 0.1 * noise.standard_normal((2400, 2))
    write(folder / "low.csv", learned)
    ended = bearing_twin(
        folder, "identify", "low.csv", "--config", "site.toml", "--asset", "motor-1",
        "--at-rest", "--out", "model.json", "--json",
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)["parameters"]
    for name, value in TRUE.items():
        assert found[name]["value"] == pytest.approx(value, rel=0.1), name
        assert found[name]["verdict"] == "informed"

    heavy = run(*duty(1800, 70.0, 90.0, 2))
    write(folder / "history.csv", heavy[:601])
    ahead = heavy[600:, :4] - np.array([600.0, 0.0, 0.0, 0.0])
    write(folder / "profile.csv", ahead, HEADER[:4])
    ended = bearing_twin(
        folder, "forecast", "model.json", "--history", "history.csv", "--profile", "profile.csv",
        "--out", "forecast.csv", "--json",
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    with (folder / "forecast.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 1200
    for name, column in (("t_winding_c", 4), ("t_body_c", 5)):
        low, middle, high = (
            np.array([float(row[f"{name}_{level}"]) for row in rows])
            for level in ("q025", "q50", "q975")
        )
        truth = heavy[600:, column]
        assert np.ptp(truth) > 15.0, "there is something to forecast"
        # 50 A learned, 90 A forecast: more than three times the heat.
        assert np.sqrt(np.mean((middle - truth) ** 2)) < 0.06 * np.max(truth - 22.0)
        assert np.mean((low <= truth) & (truth <= high)) > 0.9


def test_rows_are_as_fine_as_the_winding_is_fast(folder: Path) -> None:
    section = read_network(folder / "motor.toml")
    machine = Machine("default", None, section)
    recording = read_recording(write(folder / "fine.csv", run(*duty(600, 20.0, 50.0, 3))), section)
    step_s = step_of(recording, machine, machine.build())
    # The winding's time constant is some 25 s at the prior's centre: five rows each.
    assert step_s == 5.0
    rows = rows_of_recording(recording, step_s)
    assert rows.size == 121
    assert list(rows.inputs) == ["coolant_c", "current_a"]
    # A current counts by its square: the heat of a step is that of its rows.
    spans = recording.inputs["current_a"][:595].reshape(-1, 5)
    expected = np.sqrt((spans**2).mean(axis=1))
    np.testing.assert_allclose(rows.inputs["current_a"][:119], expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("fastest_s", "spacing_s", "duration_s", "expected"),
    [
        (3600.0, 1.0, 3600.0, 60.0),
        (300.0, 1.0, 3600.0, 60.0),
        (100.0, 1.0, 3600.0, 20.0),
        (100.0, 30.0, 3600.0, 30.0),
        (12.0, 0.3, 600.0, 2.0),
        (1.0, 0.3, 600.0, 1.0),
        (12.0, 0.3, 72 * 3600.0, 15.0),
    ],
)
def test_the_step_follows_network_spacing_and_length(
    fastest_s: float, spacing_s: float, duration_s: float, expected: float
) -> None:
    assert row_step_s(fastest_s, spacing_s, duration_s) == expected


def test_columns_that_no_law_asks_for_may_be_missing_and_inputs_may_not(folder: Path) -> None:
    section = read_network(folder / "motor.toml")
    rows = run(*duty(120, 20.0, 50.0, 4))
    found = read_recording(write(folder / "short.csv", rows), section)
    assert not found.speed_rpm.any()
    assert not found.load_n.any()
    names = ("time_s", "coolant_c", "ambient_c", "t_winding_c", "t_body_c")
    bare = write(folder / "bare.csv", rows[:, [0, 2, 3, 4, 5]], names)
    with pytest.raises(TableError, match="missing column 'current_a'; expected time_s, ambient_c"):
        read_recording(bare, section)
    with pytest.raises(TableError, match="missing column 'coolant_c'"):
        read_profile(
            write(folder / "p.csv", rows[:, [0, 1, 3]], ("time_s", "current_a", "ambient_c")),
            section,
        )
