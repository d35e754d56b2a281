"""The command ``benchmark``: JSON, table, unknown names; what single benchmarks compare."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from bearing_twin_laboratory.benchmarks import simulation
from bearing_twin_laboratory.benchmarks.cold import identified, keep, read
from bearing_twin_laboratory.benchmarks.common import BenchmarkError, Measurement, shortest_s
from bearing_twin_laboratory.benchmarks.registry import BENCHMARKS, ON_REQUEST, chosen
from service.cli.main import app
from twin_core.bearings import bearing
from twin_core.models import build_model
from twin_core.simulation import OperatingProfile, simulate
from twin_core.windows import MinuteData

pytestmark = pytest.mark.wires


def test_json_has_value_unit_reference_ratio_and_more() -> None:
    result = CliRunner().invoke(app, ["benchmark", "simulate_14_node", "--json"])
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert list(document) == ["simulate_14_node"]
    entry = document["simulate_14_node"]
    assert {"value", "unit", "reference", "ratio", "max_error_k"} <= set(entry)
    assert entry["unit"] == "s"
    assert 1e-5 < entry["value"] < 0.1
    assert entry["ratio"] == pytest.approx(entry["value"] / entry["reference"])
    assert entry["max_error_k"] < 0.02 < entry["reference_max_error_k"]


def test_an_unknown_name_is_refused_before_anything_runs() -> None:
    with pytest.raises(BenchmarkError, match="benchmark 'simulate': expected one of simulate_14_"):
        chosen(["simulate_14_node", "simulate"])
    assert {*chosen([]), *ON_REQUEST} == set(BENCHMARKS)
    assert not set(chosen([])) & set(ON_REQUEST)
    assert chosen(["fleet_store"]) == ("fleet_store",)
    assert chosen(["forecast_ensemble", "forecast_ensemble"]) == ("forecast_ensemble",)


def test_every_line_of_the_registry_leads_to_a_function() -> None:
    from importlib import import_module

    for place in BENCHMARKS.values():
        module, _, function = place.partition(":")
        home = import_module(f"bearing_twin_laboratory.benchmarks.{module}")
        assert callable(getattr(home, function))


def test_ratio_and_document_without_a_reference() -> None:
    alone = Measurement(2.0, "s")
    assert alone.ratio is None
    assert alone.to_dict()["reference"] is None
    assert Measurement(2.0, "s", 8.0, "", {"lost": 0}).to_dict() == {
        "value": 2.0,
        "unit": "s",
        "reference": 8.0,
        "ratio": 0.25,
        "compared_with": "",
        "lost": 0,
    }


def test_the_shortest_call_counts_and_the_first_does_not() -> None:
    calls: list[int] = []
    assert 0.0 <= shortest_s(lambda: calls.append(1), at_least_s=0.0, at_least=4) < 0.1
    assert len(calls) == 5


def test_the_library_solver_solves_the_same_problem() -> None:
    model = build_model("paper", bearing=bearing("6311"))
    profile = simulation.staircase()
    assert profile.size == 541
    own = simulate(model, model.parameters.centre, profile, np.full(13, simulation.AMBIENT_C))
    library = simulation._solved(model, "LSODA", 1e-6, 1e-6)
    error = (own.temperatures_c - library) @ model.sensor_matrix(model.sensor_names).T
    assert np.abs(error).max() < 0.02


def test_a_cold_process_identifies_the_same_rows(tmp_path) -> None:  # type: ignore[no-untyped-def]
    model = build_model("paper", bearing=bearing("6311"))
    time_s = 60.0 * np.arange(40.0)
    speed, load, ambient = np.full(40, 3000.0), np.full(40, 2650.0), np.full(40, 22.0)
    path = simulate(
        model,
        model.parameters.centre,
        OperatingProfile(time_s, speed, load, ambient),
        np.full(13, 22.0),
    ).temperatures_c
    rows = MinuteData(
        time_s,
        speed,
        load,
        ambient,
        {name: path @ model.sensor_row(name) for name in model.sensor_names},
        np.ones(40, dtype=np.bool_),
    )
    keep(tmp_path / "rows.npz", rows)
    again = read(tmp_path / "rows.npz")
    assert list(again.temperatures_c) == list(rows.temperatures_c)
    for name, values in rows.temperatures_c.items():
        assert again.temperatures_c[name].tolist() == values.tolist()
    assert identified("paper", "6311", again).status == "converged"
