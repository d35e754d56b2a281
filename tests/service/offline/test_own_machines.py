"""identify and forecast with a bearing by its dimensions, and with a network of one's own."""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from site_files import COLUMNS, asset_text

from service.site.machines.machine import Machine
from service.site.machines.networks import read_network
from twin_core.simulation import OperatingProfile, simulate

from .files import Run, write

GEARBOX = Path(__file__).parents[3] / "deploy" / "networks" / "gearbox.toml"
CONFIGURATION = '[bearings."spindle"]\nbore_mm = 55\nouter_mm = 120\nwidth_mm = 29\n' + asset_text(
    "gear-1",
    (*COLUMNS, "t_bearing_c", "t_wall_c"),
    machine='network = "gearbox.toml"',
    low_risk=(2000, 4000),
)
TRUTH = {"friction": 1.5, "mesh": 0.7, "seat": 1.3, "splash": 0.6, "film": 1.15, "to_bearing": 0.9}
HEADER = ("time_s", "speed_rpm", "load_n", "ambient_c", "t_bearing_c", "t_wall_c")
STEPS = ((800.0, 1500.0), (1500.0, 1500.0), (1500.0, 3500.0), (2200.0, 2500.0))


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "gearbox.toml").write_text(GEARBOX.read_text())
    file = tmp_path / "twin.toml"
    file.write_text(CONFIGURATION)
    return file


@pytest.fixture(scope="module")
def gearbox_run() -> np.ndarray:
    """Eight hours of a gearbox of other values than the priors', minute by minute, with noise."""
    model = Machine("default", None, read_network(GEARBOX)).build()
    values = model.parameters.centre * [TRUTH[name] for name in model.parameters.names]
    speed, load = np.repeat(np.array(STEPS), 120, axis=0).T
    profile = OperatingProfile(np.arange(480) * 60.0, speed, load, np.full(480, 21.0))
    nodes = simulate(model, values, profile, np.full(3, 21.0)).temperatures_c
    rng = np.random.default_rng(3)
    read = [nodes @ model.sensor_row(name) for name in model.sensor_names]
    noisy = [values_c + 0.05 * rng.standard_normal(480) for values_c in read]
    return np.stack([profile.time_s, speed, load, profile.ambient_c, *noisy], axis=1)


def test_a_network_of_ones_own_is_identified_and_forecasts(
    tmp_path: Path, config: Path, gearbox_run: np.ndarray, command: Callable[..., Any]
) -> None:
    low = write(tmp_path / "low.csv", gearbox_run[:361], HEADER)
    model = tmp_path / "model.json"
    found = command(
        "identify", low, "--config", config, "--asset", "gear-1", "--out", model, "--at-rest",
        "--method", "refine", "--json",
    )  # fmt: skip
    assert (found["model"], found["bearing"]) == ("gearbox", "gearbox")
    assert set(found["parameters"]) == set(TRUTH)
    assert found["rms_error_k"] < 0.15
    assert found["parameters"]["friction"]["low"] < 0.075 < found["parameters"]["friction"]["high"]
    document = json.loads(model.read_text())
    assert document["machine"]["network"]["name"] == "gearbox"

    # The model file alone is enough: the configuration and the network's file may be gone.
    config.unlink()
    (tmp_path / "gearbox.toml").unlink()
    ahead = gearbox_run[360:].copy()
    ahead[:, 0] -= ahead[0, 0]
    profile = write(tmp_path / "profile.csv", ahead[:, :4], HEADER[:4])
    out = tmp_path / "forecast.csv"
    answer = command(
        "forecast", model, "--history", low, "--profile", profile, "--out", out, "--json"
    )
    assert set(answer["sensors"]) == {"t_bearing_c", "t_wall_c"}
    with out.open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    names = {column.rpartition("_")[0] for column in rows[0]} - {"time"}
    whole_runs = {f"{name}_whole" for name in answer["sensors"]}
    assert names == {"t_bearing_c", "t_wall_c", "t_housing_c", "t_oil_c"} | whole_runs
    for column, name in enumerate(HEADER[4:], start=4):
        low_c, mid_c, high_c = (
            np.array([float(row[f"{name}_{level}"]) for row in rows])
            for level in ("q025", "q50", "q975")
        )
        assert np.abs(mid_c - ahead[:, column]).max() < 1.0
        assert np.mean((low_c <= ahead[:, column]) & (ahead[:, column] <= high_c)) > 0.9


def test_columns_are_those_of_the_network(
    tmp_path: Path, config: Path, gearbox_run: np.ndarray, complaint: Callable[..., str]
) -> None:
    options = ("--config", config, "--asset", "gear-1", "--out", tmp_path / "m.json")
    for header, expected in (
        ((*HEADER[:4], "t_inner_ring_c", "t_wall_c"), "unknown column 't_inner_ring_c'; expected"),
        ((*HEADER[:4],), "no column with a temperature; expected time_s, speed_rpm, load_n"),
    ):
        data = write(tmp_path / "data.csv", gearbox_run[:9, : len(header)], header)
        assert expected in complaint("identify", data, *options)
        assert "t_bearing_c, t_wall_c, t_housing_c, t_oil_c" in complaint(
            "identify", data, *options
        )


def test_a_bearing_of_ones_own_is_identified(
    tmp_path: Path, config: Path, run: Run, command: Callable[..., Any]
) -> None:
    data = write(tmp_path / "low.csv", run.rows(300))
    own = tmp_path / "own.toml"
    own.write_text("bore_mm = 55\nouter_mm = 120\nwidth_mm = 29\nstatic_load_rating_n = 45000\n")
    documents = []
    for given in (("--bearing", own), ("--bearing", "spindle", "--config", config)):
        model = tmp_path / "model.json"
        found = command(
            "identify", data, *given, "--out", model, "--method", "refine", "--at-rest", "--json"
        )
        documents.append(json.loads(model.read_text())["machine"]["bearing"])
        assert found["bearing"] in ("own", "spindle")
        assert found["rms_error_k"] < 0.5
    assert documents[0]["static_load_rating_n"] == 45000.0
    assert documents[1]["static_load_rating_n"] is None


def test_which_bearing_was_meant_is_asked(
    tmp_path: Path, config: Path, complaint: Callable[..., str]
) -> None:
    options = ("--out", tmp_path / "m.json")
    data = tmp_path / "data.csv"
    assert "unknown bearing 'spindel'" in complaint(
        "identify", data, "--bearing", "spindel", "--config", config, *options
    )
    assert "absent.toml: cannot be read" in complaint(
        "identify", data, "--bearing", tmp_path / "absent.toml", *options
    )
    assert "expected one of its assets (gear-1)" in complaint(
        "identify", data, "--config", config, *options
    )
    assert "--bearing 'spindle': expected none, asset 'gear-1'" in complaint(
        "identify", data, "--bearing", "spindle", "--config", config, "--asset", "gear-1", *options
    )
