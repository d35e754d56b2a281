import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from patience import patience
from typer.testing import CliRunner

from service.cli.main import app
from twin_core.bearings import bearing
from twin_core.models import build_model
from twin_core.simulation import OperatingProfile, simulate

from .files import HEADER, LOW_S, Run, read, steps_file, write

pytestmark = pytest.mark.wires

Command = Callable[..., Any]

QUICK = ("--method", "refine")
SENSORS = ("t_inner_ring_c", "t_outer_ring_c")
NAMES = (*SENSORS, *(f"t_node_{number}_c" for number in range(1, 14)))
LEVELS = ("q025", "q25", "q50", "q75", "q975")


def twin(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "service", *(str(argument) for argument in arguments)],
        capture_output=True,
        text=True,
        timeout=patience(280),
        check=False,
    )


@pytest.fixture
def data(run: Run, tmp_path: Path) -> Path:
    return write(tmp_path / "data.csv", run.rows(60))


def high_profile(path: Path, run: Run) -> Path:
    """What the bench did after the low part, minute by minute."""
    rows = run.rows(60, LOW_S, len(run.measured) - 1)[:, :4]
    rows[:, 0] -= LOW_S
    return steps_file(path, rows)


def judge(run: Run, forecast: dict[str, np.ndarray]) -> tuple[float, float]:
    """Largest error of the medians and smallest coverage of the bands over the high part."""
    at = (LOW_S + forecast["time_s"]).astype(int)
    errors, coverage = [], []
    for column, name, truth_c in ((4, SENSORS[0], run.inner_c), (5, SENSORS[1], run.outer_c)):
        errors.append(np.max(np.abs(forecast[f"{name}_q50"] - truth_c[at])))
        shown = run.measured[at, column]
        inside = (shown >= forecast[f"{name}_q025"]) & (shown <= forecast[f"{name}_q975"])
        coverage.append(np.mean(inside))
    return max(errors), min(coverage)


def test_identify_then_forecast_as_a_user_does(run: Run, data: Path, tmp_path: Path) -> None:
    model, out = tmp_path / "model.json", tmp_path / "forecast.csv"
    profile = high_profile(tmp_path / "profile.csv", run)
    first = twin(
        "identify",
        data,
        "--bearing",
        "6311",
        "--at-rest",
        "--budget",
        100,
        "--out",
        model,
        "--json",
    )
    assert (first.returncode, first.stderr) == (0, "")
    found = json.loads(first.stdout)
    assert set(found["parameters"]["M0"]) >= {"value", "unit", "low", "high", "verdict"}
    for row in found["parameters"].values():
        assert row["low"] <= row["value"] <= row["high"]
        assert row["verdict"] in ("informed", "weak", "prior only")
    assert found["model"] == "default"
    assert 0.05 < found["rms_error_k"] < 0.3
    assert found["evaluations"] > 100
    assert found["seconds"] > 0.0
    assert found["condition"] > 1.0
    assert 0 < found["rank"] <= len(found["parameters"])
    told = found["identifiability"]
    assert (told["rank"], told["condition"]) == (found["rank"], found["condition"])
    assert told["informed"] == found["informed_combinations"] > 1
    assert len(told["combinations"]) == len(found["parameters"])
    assert set(told["combinations"][0]["weights"]) <= set(found["parameters"])
    assert set(found["naive"]) == {"persistence", "static_linear", "arx"}
    assert found["naive"]["static_linear"]["t_inner_ring_c"] > found["rms_error_k"]

    second = twin(
        "forecast", model, "--history", data, "--profile", profile, "--out", out, "--json"
    )
    assert (second.returncode, second.stderr) == (0, "")
    told = json.loads(second.stdout)
    forecast = read(out)
    edges = [f"{name}_whole_{edge}" for name in SENSORS for edge in ("low", "high")]
    columns = [f"{name}_{level}" for name in NAMES for level in LEVELS]
    assert list(forecast) == ["time_s", *columns, *edges]
    np.testing.assert_array_equal(forecast["time_s"], read(profile)["time_s"])
    for name in NAMES:
        bands = np.array([forecast[f"{name}_{level}"] for level in LEVELS])
        assert (np.diff(bands, axis=0) >= 0.0).all()
    assert told["out"] == str(out)
    for name in SENSORS:
        assert told["sensors"][name]["max_q50_c"] == pytest.approx(
            forecast[f"{name}_q50"].max(), abs=1e-4
        )
        assert told["sensors"][name]["max_q975_c"] == pytest.approx(
            forecast[f"{name}_q975"].max(), abs=1e-4
        )
        low, median, high = (forecast[f"{name}_{of}"] for of in ("whole_low", "q50", "whole_high"))
        assert ((low < median) & (median < high)).all()
        assert told["sensors"][name]["max_whole_run_c"] == pytest.approx(high.max(), abs=1e-4)
    assert told["whole_run_level"] == 0.9
    # 5600 rpm, a third above all that was seen, for 40 minutes
    error_k, coverage = judge(run, forecast)
    assert error_k < 2.5
    assert coverage > 0.93


@pytest.mark.parametrize(("every_s", "start_s"), [(1, 0), (10, 0), (10, 1500), (60, 1500)])
def test_any_spacing_and_a_warm_start_forecast_alike(
    run: Run, tmp_path: Path, command: Command, every_s: int, start_s: int
) -> None:
    data = write(tmp_path / "data.csv", run.rows(every_s, start_s))
    model, out = tmp_path / "model.json", tmp_path / "forecast.csv"
    rest = () if start_s else ("--at-rest",)
    found = command("identify", data, "--bearing", "6311", *rest, *QUICK, "--out", model, "--json")
    assert found["rows"] == (LOW_S - start_s) // 60 + 1
    assert found["windows"] == 1
    assert found["rms_error_k"] < 0.3
    profile = high_profile(tmp_path / "profile.csv", run)
    command("forecast", model, "--history", data, "--profile", profile, "--out", out)
    error_k, coverage = judge(run, read(out))
    assert error_k < 3.5
    assert coverage > 0.93


def test_gaps_make_windows_and_missing_cells_are_left_out(
    run: Run, tmp_path: Path, command: Command
) -> None:
    rows = run.rows(60)
    rows[10:30, 4] = np.nan
    rows[40, 1] = np.nan
    rows = np.delete(rows, slice(60, 70), axis=0)
    data = write(tmp_path / "data.csv", rows)
    found = command(
        "identify", data, "--bearing", "6311", "--at-rest", *QUICK,
        "--out", tmp_path / "model.json", "--json",
    )  # fmt: skip
    assert found["windows"] == 2
    assert found["rows"] == len(rows) - 1
    assert found["rms_error_k"] < 0.3


def test_same_seed_same_result_and_a_readable_table(
    data: Path, tmp_path: Path, command: Command
) -> None:
    arguments = ("identify", data, "--bearing", "6311", "--at-rest", "--budget", 50, "--seed", 3)
    models = [tmp_path / "one.json", tmp_path / "two.json"]
    found = [command(*arguments, "--out", model, "--json") for model in models]
    assert found[0]["parameters"] == found[1]["parameters"]
    assert models[0].read_text() == models[1].read_text()
    command(*arguments[:-1], 4, "--out", models[1])
    assert models[0].read_text() != models[1].read_text()
    text = command(*arguments, "--out", models[0])
    assert "identifiability" in text
    assert "rest on the prior alone; rank" in text
    assert "M0" in text
    assert "informed" in text
    assert "static linear" in text


@pytest.fixture
def configuration(tmp_path: Path) -> Path:
    path = tmp_path / "twin.toml"
    path.write_text(
        '[[sources]]\nname = "logger"\ndriver = "push"\n'
        '[[assets]]\nid = "motor-7"\nbearing = "6016"\nmodel = "paper"\n'
        "low_risk = { speed_rpm_max = 4300, load_n_max = 3300 }\n"
        'channels = { t_inner_ring_c = { source = "push" } }\n'
    )
    return path


def test_bearing_and_model_come_from_the_configuration(
    run: Run, configuration: Path, tmp_path: Path, command: Command
) -> None:
    rows = run.rows(60)
    paper = build_model("paper", bearing=bearing("6016"))
    profile = OperatingProfile(*(rows[:, column].copy() for column in range(4)))
    values = paper.parameters.values_from_z(np.full(paper.parameters.size, 0.3))
    nodes = simulate(paper, values, profile, np.full(13, rows[0, 3])).temperatures_c
    rows[:, 4:] = nodes @ paper.sensor_matrix(SENSORS).T
    data, model = write(tmp_path / "data.csv", rows), tmp_path / "model.json"
    found = command(
        "identify", data, "--config", configuration, "--asset", "motor-7", "--at-rest", *QUICK,
        "--out", model, "--json",
    )  # fmt: skip
    assert (found["bearing"], found["model"]) == ("6016", "paper")
    assert found["rms_error_k"] < 0.1
    profile_file, out = steps_file(tmp_path / "p.csv", [(0, 4200, 2650, 22)]), tmp_path / "out.csv"
    command("forecast", model, "--history", data, "--profile", profile_file, "--out", out)
    assert read(out)["t_inner_ring_c_q50"][0] == pytest.approx(rows[-1, 4], abs=0.2)


def test_wrong_options_are_refused_in_one_line(
    configuration: Path, data: Path, tmp_path: Path, complaint: Callable[..., str]
) -> None:
    model = tmp_path / "model.json"

    def refusal(*options: object, out: Path = model) -> str:
        text = complaint("identify", data, *options, "--out", out)
        assert not model.exists()
        return text

    known = ("--config", configuration, "--asset", "motor-7")
    assert refusal() == "--bearing is missing; expected it, or --config and --asset"
    assert "unknown bearing '6999', expected one of 6016, 6311" in refusal("--bearing", "6999")
    assert refusal(*known, "--bearing", "6311").startswith("--bearing '6311': expected '6016'")
    assert "expected one of its assets (motor-7)" in refusal("--config", configuration)
    assert "expected one of the assets" in refusal("--config", configuration, "--asset", "pump")
    assert "without --config" in refusal("--asset", "pump", "--bearing", "6311")
    assert "cannot be read" in refusal("--config", tmp_path / "none.toml", "--asset", "pump")
    chosen = ("--bearing", "6311")
    assert refusal(*chosen, "--method", "swarm") == (
        "--method 'swarm': expected one of noa+refine, noa, refine, pso, pso+refine, de, "
        "de+refine, cma-es, cma-es+refine, trf, trf+refine"
    )
    assert refusal(*chosen, "--model", "mine") == (
        "--model 'mine': expected one of default, paper, paper-reduced"
    )
    assert refusal(*chosen, "--budget", 10) == "--budget 10: expected at least 25"
    assert refusal(*chosen, "--seed", -1) == "--seed -1: expected 0 or more"
    nowhere = tmp_path / "none" / "model.json"
    assert "expected a file in an existing folder" in refusal(*chosen, out=nowhere)


def test_data_that_teach_nothing_or_contradict_at_rest_are_refused(
    run: Run, tmp_path: Path, complaint: Callable[..., str]
) -> None:
    path = tmp_path / "data.csv"

    def refusal(rows: np.ndarray, *options: str) -> str:
        write(path, rows)
        return complaint(
            "identify", path, "--bearing", "6311", "--out", tmp_path / "model.json", *options
        )

    rows = run.rows(60)
    assert "expected at least 3" in refusal(rows[:2])
    blind = rows.copy()
    blind[:, 4:] = np.nan
    assert "no row with temperature; expected at least 3" in refusal(blind)
    still = rows.copy()
    still[:, 2] = np.nan
    assert "no row with speed_rpm, load_n and ambient_c" in refusal(still)
    warm = refusal(run.rows(60, 3000), "--at-rest")
    assert warm.startswith("data.csv: t_inner_ring_c = ")
    assert "expected a machine at ambient temperature with --at-rest" in warm


def test_bad_input_ends_with_one_line_and_status_2(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text(",".join(HEADER) + "\n0,fast,2650,22,22,22\n")
    result = twin("identify", path, "--bearing", "6311", "--out", tmp_path / "model.json")
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == (
        "bearing-twin: data.csv: line 2: speed_rpm = 'fast': expected a number or an empty cell\n"
    )


def test_a_failed_fit_ends_with_status_1_and_no_model(run: Run, tmp_path: Path) -> None:
    rows = run.rows(60)
    rows[:, 4:] += 6.0 * np.sign(np.sin(rows[:, :1] / 500.0))
    data, model = write(tmp_path / "data.csv", rows), tmp_path / "model.json"
    result = CliRunner().invoke(
        app,
        ["identify", str(data), "--bearing", "6311", *QUICK, "--out", str(model), "--json"],
    )
    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr.startswith("bearing-twin: data.csv: failed fit: ")
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == [data]


def test_a_cold_machine_starts_everywhere_at_the_given_temperature(
    prior_model: Path, tmp_path: Path, command: Command
) -> None:
    out = tmp_path / "forecast.csv"
    profile = steps_file(
        tmp_path / "profile.csv", [(0, 4200, 2650, 25), (1800, 4200, 2650, 25), (3600, 0, 0, 25)]
    )
    told = command(
        "forecast", prior_model, "--initial-temperature-c", 30.5, "--profile", profile,
        "--out", out, "--json",
    )  # fmt: skip
    forecast = read(out)
    for name in NAMES:
        assert forecast[f"{name}_q50"][0] == pytest.approx(30.5, abs=0.2)
        assert 0.2 < forecast[f"{name}_q975"][0] - forecast[f"{name}_q025"][0] < 3.0
    assert (np.diff(forecast["t_inner_ring_c_q50"]) > 1.0).all()
    assert told["labels"] == ["not identified yet: prior parameters only"]
    margin = told["runaway_margin"]
    assert (margin["speed_rpm"], margin["load_n"]) == (4200.0, 2650.0)
    assert set(margin) >= {"probability", "loop_gain", "loop_gain_upper", "margin_k", "margin_n"}
    assert margin["probability"] < 0.05
    assert 0.0 < margin["margin_k"] < 130.0


def test_before_the_first_row_the_last_point_of_the_history_holds(
    prior_model: Path, data: Path, tmp_path: Path, command: Command
) -> None:
    def forecast(rows: list[tuple[float, ...]]) -> dict[str, np.ndarray]:
        profile, out = steps_file(tmp_path / "p.csv", rows), tmp_path / "forecast.csv"
        command("forecast", prior_model, "--history", data, "--profile", profile, "--out", out)
        return read(out)

    last = read(data)
    point = tuple(float(last[name][-1]) for name in HEADER[1:4])
    later = [(1800.0, 5600.0, 2650.0, 22.0), (3600.0, 5600.0, 2650.0, 22.0)]
    implied, told = forecast(later), forecast([(0.0, *point), *later])
    np.testing.assert_array_equal(implied["time_s"], [1800.0, 3600.0])
    for name in list(implied)[1:]:
        np.testing.assert_allclose(implied[name], told[name][1:], atol=2e-4)
    assert implied["t_inner_ring_c_q50"][1] > implied["t_inner_ring_c_q50"][0] + 0.5


def test_the_history_counts_to_its_last_row_whatever_is_missing_there(
    run: Run, prior_model: Path, tmp_path: Path, command: Command
) -> None:
    rows = run.rows(60)
    rows[-1, 1] = np.nan
    rows[-20:-5, 4] = np.nan
    data = write(tmp_path / "data.csv", rows)
    profile, out = steps_file(tmp_path / "p.csv", [(0, 4200, 2650, 22)]), tmp_path / "out.csv"
    command("forecast", prior_model, "--history", data, "--profile", profile, "--out", out)
    forecast = read(out)
    assert forecast["t_inner_ring_c_q50"][0] == pytest.approx(run.inner_c[LOW_S], abs=0.3)
    assert forecast["t_outer_ring_c_q50"][0] == pytest.approx(run.outer_c[LOW_S], abs=0.3)


def test_a_profile_by_the_second_is_forecast_like_one_by_the_minute(
    prior_model: Path, tmp_path: Path, command: Command
) -> None:
    def forecast(every_s: float) -> dict[str, np.ndarray]:
        time_s = np.arange(0.0, 3601.0, every_s)
        speed = np.where(time_s < 1800.0, 3000.0, 5000.0)
        rows = np.stack((time_s, speed, 0 * time_s + 2650.0, 0 * time_s + 22.0), axis=1)
        profile, out = steps_file(tmp_path / "p.csv", rows), tmp_path / "forecast.csv"
        command(
            "forecast", prior_model, "--initial-temperature-c", 22, "--profile", profile,
            "--out", out,
        )  # fmt: skip
        return read(out)

    fine, coarse = forecast(1.0), forecast(60.0)
    assert fine["time_s"].size == 3601
    for name in SENSORS:
        np.testing.assert_allclose(fine[f"{name}_q50"][::60], coarse[f"{name}_q50"], atol=0.2)


def test_forecast_refuses_what_it_cannot_start_from(
    run: Run, prior_model: Path, data: Path, tmp_path: Path, complaint: Callable[..., str]
) -> None:
    out = tmp_path / "forecast.csv"
    profile = steps_file(tmp_path / "profile.csv", [(0, 4200, 2650, 25)])

    def refusal(*options: object, model: Path = prior_model) -> str:
        text = complaint("forecast", model, *options, "--profile", profile, "--out", out)
        assert not out.exists()
        return text

    cold = ("--initial-temperature-c", 22)
    assert refusal() == "expected either --history or --initial-temperature-c"
    assert refusal(*cold, "--history", data) == (
        "expected either --history or --initial-temperature-c"
    )
    assert "expected -60 to 400" in refusal("--initial-temperature-c", 5000)
    assert "not a model file" in refusal(*cold, model=_json(tmp_path / "other.json", {}))
    blind = run.rows(60)
    blind[:, 4:] = np.nan
    assert "no row with speed_rpm, load_n, ambient_c and a temperature" in refusal(
        "--history", write(tmp_path / "blind.csv", blind)
    )
    profile.write_text("time_s,speed_rpm,load_n,ambient_c\n0,1500,2650,\n")
    assert refusal(*cold) == "profile.csv: line 2: ambient_c = '': expected a number"


def _json(path: Path, document: Any) -> Path:
    path.write_text(json.dumps(document))
    return path


def test_a_stopped_identification_leaves_nothing_and_showed_its_progress(
    data: Path, tmp_path: Path
) -> None:
    model = tmp_path / "model.json"
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [
            sys.executable, "-m", "service", "identify", str(data), "--bearing", "6311",
            "--budget", "100000000", "--out", str(model), "--json",
        ],
        stdout=subprocess.PIPE,
        stderr=slave,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "100"},
    )  # fmt: skip
    os.close(slave)
    shown = b""
    deadline = time.monotonic() + patience(90.0)
    while b"search" not in shown and time.monotonic() < deadline:
        shown += os.read(master, 4096)
    assert b"search" in shown
    process.send_signal(signal.SIGTERM)
    # What is left on the terminal must be taken off, or the process cannot end.
    try:
        while chunk := os.read(master, 4096):
            shown += chunk
    except OSError:
        pass  # the other side is closed
    output, _ = process.communicate(timeout=patience(60))
    os.close(master)
    assert (process.returncode, output) == (0, b"")
    assert b"stopped; nothing is written" in shown
    assert list(tmp_path.iterdir()) == [data]
