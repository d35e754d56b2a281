"""bearing-twin simulate: exact, with the rows' own meaning, and refusing what it cannot use."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

from service.cli.main import app
from service.offline import simulation
from service.offline.model_file import IdentifiedModel
from service.offline.simulation import simulate_profile
from service.offline.tables import PlannedRows
from twin_core.simulation import heat_balance_w, kernels

from .files import read, steps_file
from .fmus import DRIVE, bearing_model, identified_model, own_model


def by_scipy(identified: IdentifiedModel, rows: PlannedRows, start_c: float) -> np.ndarray:
    """Temperatures (n, names) by a solver that knows nothing of modes or steps."""
    model, values = identified.model, identified.values
    capacity = kernels.bind_network(model.compiled, values)[0]
    state = np.append(np.full(capacity.size, start_c), identified.run_in.revolutions[0])
    found = [state]
    for row in range(rows.time_s.size - 1):
        held = model.holding(rows.inputs[row]) if rows.inputs.size else model
        point = float(rows.speed_rpm[row]), float(rows.load_n[row]), float(rows.ambient_c[row])

        def slopes(_: float, state: np.ndarray, held: Any = held, point: Any = point) -> np.ndarray:
            flow, _ = heat_balance_w(held, values, state[:-1], *point, float(state[-1]))
            return np.append(flow / capacity, point[0] / 60.0)

        span = rows.time_s[row], rows.time_s[row + 1]
        solved = solve_ivp(slopes, span, state, "Radau", rtol=1e-10, atol=1e-9)
        state = solved.y[:, -1]
        found.append(state)
    nodes = np.array(found)[:, :-1]
    return nodes @ model.sensor_matrix(simulation.output_names(identified)).T


@pytest.mark.parametrize("kind", ["default", "own"])
def test_a_simulation_is_the_solution_of_the_heat_balance(kind: str, tmp_path: Path) -> None:
    machine = bearing_model() if kind == "default" else own_model(DRIVE, tmp_path)
    identified = identified_model(machine, 3)
    speed = np.array([3000.0, 0.0, 5200.0, 5200.0])
    rows = PlannedRows(
        np.array([0.0, 1800.0, 2100.0, 4000.0]),
        speed,
        np.array([2650.0, 0.0, 4000.0, 4000.0]),
        np.array([20.0, 25.0, 18.0, 18.0]),
        np.array([[30.0, 60.0, 90.0]] * 4) if kind == "own" else np.empty((0, 0)),
    )
    found = simulate_profile(identified, rows, 20.0)
    np.testing.assert_allclose(
        found.temperatures_c, by_scipy(identified, rows, 20.0), rtol=0.0, atol=1e-6
    )


def test_a_profile_that_is_divided_gives_the_same() -> None:
    identified = identified_model(bearing_model(), 4)
    columns = np.array([4200.0, 4200.0]), np.array([2650.0, 2650.0]), np.array([21.0, 21.0])
    whole = simulate_profile(identified, PlannedRows(np.array([5.0, 4005.0]), *columns), 35.0)
    cuts = np.array([5.0, 5.25, 12.0, 803.7, 3900.0, 4005.0])
    ones = np.ones(cuts.size)
    parts = simulate_profile(
        identified, PlannedRows(cuts, *(column[0] * ones for column in columns)), 35.0
    )
    np.testing.assert_allclose(
        parts.temperatures_c[-1], whole.temperatures_c[-1], rtol=0.0, atol=1e-7
    )
    assert (whole.temperatures_c[0] == 35.0).all()


def test_the_command_writes_every_sensor_and_node(
    prior_model: Path, command: Callable[..., Any], tmp_path: Path
) -> None:
    identified = IdentifiedModel.load(prior_model)
    fresh = replace(identified, run_in=replace(identified.run_in, revolutions=np.zeros(2)))
    fresh.save(prior_model)
    profile = steps_file(
        tmp_path / "profile.csv", [[0, 3000, 2650, 20], [1800, 0, 0, 20], [3600, 0, 0, 20]]
    )
    out = tmp_path / "out.csv"
    document = command(
        "simulate", prior_model, "--profile", profile, "--initial-temperature-c", 20,
        "--out", out, "--json",
    )  # fmt: skip
    table = read(out)
    nodes = tuple(f"t_node_{number}_c" for number in range(1, 14))
    assert tuple(table) == ("time_s", "t_inner_ring_c", "t_outer_ring_c", *nodes)
    assert table["time_s"].tolist() == [0.0, 1800.0, 3600.0]
    assert document["out"] == str(out)
    assert document["sensors"]["t_inner_ring_c"]["max_c"] == pytest.approx(
        table["t_inner_ring_c"].max(), abs=1e-9
    )
    # Warm by friction, then cooling down; grease that has run in gives less heat.
    inner = table["t_inner_ring_c"]
    assert inner[0] == 20.0
    assert inner[1] > inner[2] > 21.0
    rows = PlannedRows(
        table["time_s"], np.array([3000.0, 0, 0]), np.array([2650.0, 0, 0]), np.full(3, 20.0)
    )
    run_in = replace(fresh, run_in=replace(fresh.run_in, revolutions=np.full(2, 2e6)))
    assert simulate_profile(run_in, rows, 20.0).temperatures_c[1, 0] < inner[1] - 0.1


def test_what_cannot_be_simulated_is_refused(
    prior_model: Path, complaint: Callable[..., str], tmp_path: Path
) -> None:
    profile = steps_file(tmp_path / "profile.csv", [[0, 3000, 2650, 20], [60, 0, 0, 20]])
    call = ("simulate", prior_model, "--profile", profile, "--out", tmp_path / "out.csv")
    said = complaint(*call, "--initial-temperature-c", 900)
    assert said == "--initial-temperature-c 900: expected -60 to 400"
    (tmp_path / "short.csv").write_text("time_s,speed_rpm,ambient_c\n0,1,20\n")
    short = ("simulate", prior_model, "--profile", tmp_path / "short.csv")
    said = complaint(*short, "--out", tmp_path / "out.csv", "--initial-temperature-c", 20)
    assert "missing column 'load_n'" in said
    assert not (tmp_path / "out.csv").exists()


def test_a_machine_that_runs_away_ends_with_status_1(tmp_path: Path) -> None:
    identified = identified_model(own_model(DRIVE, tmp_path), 3)
    identified.save(tmp_path / "drive.json")
    header = "time_s,speed_rpm,load_n,ambient_c,coolant_c,current_a,power_w\n"
    rows = "0,1500,1000,20,20,4000,0\n86400,1500,1000,20,20,4000,0\n"
    (tmp_path / "profile.csv").write_text(header + rows)
    result = CliRunner().invoke(
        app,
        ["simulate", str(tmp_path / "drive.json"), "--profile", str(tmp_path / "profile.csv"),
         "--initial-temperature-c", "20", "--out", str(tmp_path / "out.csv")],
    )  # fmt: skip
    assert result.exit_code == 1
    assert "ran away" in result.stderr
    assert not (tmp_path / "out.csv").exists()
