"""FMUs against the product, in FMPy, a program that we did not write."""

import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from programs import needed

from service.offline.model_file import IdentifiedModel
from service.offline.simulation import SimulatedRows, simulate_profile
from service.offline.tables import PlannedRows

from .files import read, steps_file
from .fmus import (
    DAY_S,
    DRIVE,
    PERIOD_S,
    FloatArray,
    bearing_model,
    day,
    identified_model,
    own_model,
    run_fmu,
    signals,
)

pytestmark = pytest.mark.wires

START_C = 31.0
OPERATION = ("speed_rpm", "load_n", "ambient_c")
OWN = {"default": (), "paper": (), "drive": ("coolant_c", "current_a", "power_w")}


@dataclass(frozen=True)
class Case:
    """A model, a day of it as `simulate` computes it, and its FMUs by version."""

    name: str
    identified: IdentifiedModel
    rows: PlannedRows
    simulated: SimulatedRows
    fmus: dict[int, Path]
    documents: dict[int, dict[str, Any]]

    def run(self, fmi: int, **options: Any) -> Any:
        start = {"initial_temperature_c": START_C} | options.pop("start_values", {})
        own = OWN[self.name]
        rows = options.pop("rows", self.rows)
        return run_fmu(self.fmus[fmi], rows, (*OPERATION, *own), own, start_values=start, **options)

    def errors_k(self, result: Any, simulated: SimulatedRows | None = None) -> FloatArray:
        """Largest difference of every output from `simulate` at the rows."""
        expected = simulated or self.simulated
        at = np.searchsorted(result["time"], expected.time_s - 1e-3)
        found = np.column_stack([result[name] for name in expected.names])[at]
        np.testing.assert_allclose(result["time"][at], expected.time_s, atol=1e-6)
        return np.abs(found - expected.temperatures_c).max(axis=0)


@pytest.fixture(scope="module", params=OWN)
def case(
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
    run_command: Callable[..., Any],
) -> Case:
    needed("gcc libc6-dev", "cc")
    name: str = request.param
    folder = tmp_path_factory.mktemp(name)
    machine = own_model(DRIVE, folder) if name == "drive" else bearing_model(name)
    identified = identified_model(machine, 11)
    identified.save(folder / "model.json")
    fmus = {fmi: folder / f"{name}{fmi}.fmu" for fmi in (2, 3)}
    documents = {
        fmi: run_command("export-fmu", folder / "model.json", "--out", path, "--fmi", fmi, "--json")
        for fmi, path in fmus.items()
    }
    rows = day(identified, 5)
    return Case(
        name, identified, rows, simulate_profile(identified, rows, START_C), fmus, documents
    )


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_standard_finds_no_fault_and_names_are_those_of_the_product(
    case: Case, fmi: int
) -> None:
    assert validate_fmu(str(case.fmus[fmi])) == []
    description = fmpy.read_model_description(str(case.fmus[fmi]))
    kinds: dict[str, list[str]] = {}
    for variable in description.modelVariables:
        kinds.setdefault(variable.causality, []).append(variable.name)
    document = case.documents[fmi]
    assert kinds["input"] == document["inputs"] == [*OPERATION, *OWN[case.name]]
    assert kinds["output"] == document["outputs"] == list(case.simulated.names)
    assert kinds["parameter"] == document["parameters"]
    # Not one bit of what was identified is lost on the way into the file.
    starts = {one.name: one.start for one in description.modelVariables}
    names = case.identified.model.parameters.names
    assert [float(starts[f"parameter.{name}"]) for name in names] == list(case.identified.values)
    assert float(starts["initial_revolutions"]) == 120_000.0
    # What makes sense of a parameter, and what an importer may rely on.
    for one, low, high in zip(
        names,
        case.identified.model.parameters.lower,
        case.identified.model.parameters.upper,
        strict=True,
    ):
        variable = next(v for v in description.modelVariables if v.name == f"parameter.{one}")
        assert (float(variable.min), float(variable.max)) == (low, high)
        assert low <= float(variable.start) <= high
    assert [one.name for one in description.logCategories] == ["logStatusError"]
    if fmi == 2:
        assert description.coSimulation.canNotUseMemoryManagementFunctions
        assert description.modelExchange.canNotUseMemoryManagementFunctions
    # An importer of another platform finds every file that it needs.
    with zipfile.ZipFile(case.fmus[fmi]) as archive:
        inside = set(archive.namelist())
        xml = "modelDescription.xml" if fmi == 2 else "sources/buildDescription.xml"
        tree = ElementTree.fromstring(archive.read(xml))
        assert b"Redistribution" in archive.read("documentation/licenses/license.txt")
    files = {one.get("name") for one in tree.iter("File" if fmi == 2 else "SourceFile")}
    assert {f"sources/{name}" for name in files} <= inside
    assert {f"{name}.c" for name in ("model", "laws", f"fmi{fmi}")} <= files


@pytest.mark.parametrize("fmi", [2, 3])
def test_co_simulation_of_a_day_is_the_product_and_a_thousand_times_faster_than_time(
    case: Case, fmi: int
) -> None:
    began = time.monotonic()
    result = case.run(fmi, fmi_type="CoSimulation", step_size=PERIOD_S)
    taken_s = time.monotonic() - began
    assert case.errors_k(result).max() < 1e-6
    assert DAY_S / taken_s > 1000.0
    # At any communication points, also such that are no parts of the steps.
    result = case.run(fmi, fmi_type="CoSimulation", period_s=43.2)
    assert case.errors_k(result).max() < 1e-6


@pytest.mark.parametrize("fmi", [2, 3])
def test_model_exchange_of_a_day_is_the_product(case: Case, fmi: int) -> None:
    result = case.run(fmi, fmi_type="ModelExchange", relative_tolerance=1e-11)
    assert case.errors_k(result).max() < 1e-6
    # With the tolerance that the description proposes.
    assert case.errors_k(case.run(fmi, fmi_type="ModelExchange")).max() < 1e-5


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_parameters_have_the_effect_that_they_have_in_the_product(
    case: Case, fmi: int, kind: str
) -> None:
    identified = case.identified
    z = identified.posterior.z + 0.4
    other = replace(
        identified,
        posterior=replace(identified.posterior, z=z),
        run_in=replace(identified.run_in, revolutions=np.array([7e5, 8e5])),
    )
    rows = PlannedRows(
        case.rows.time_s[:4],
        *(getattr(case.rows, name)[:4] for name in OPERATION),
        case.rows.inputs[:4],
    )
    changed = {
        f"parameter.{name}": value
        for name, value in zip(identified.model.parameters.names, other.values, strict=True)
    }
    start = changed | {"initial_revolutions": 7e5}
    options = {"fmi_type": kind, "rows": rows, "start_values": start}
    if kind == "ModelExchange":
        options["relative_tolerance"] = 1e-11
    expected = simulate_profile(other, rows, START_C)
    assert np.ptp(expected.temperatures_c - case.simulated.temperatures_c[:4]) > 0.1
    assert case.errors_k(case.run(fmi, **options), expected).max() < 1e-6


def unpacked(path: Path, folder: Path, fmi: int, token: str | None = None) -> Any:
    description = fmpy.read_model_description(str(path))
    fmpy.extract(str(path), str(folder))
    slave = (FMU2Slave if fmi == 2 else FMU3Slave)(
        guid=description.guid if token is None else token,
        unzipDirectory=str(folder),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="bearing",
    )
    return slave, {one.name: one.valueReference for one in description.modelVariables}


def begin(slave: Any, fmi: int) -> None:
    slave.instantiate()
    if fmi == 2:
        slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_state_can_be_kept_and_taken_back(case: Case, fmi: int, tmp_path: Path) -> None:
    slave, reference = unpacked(case.fmus[fmi], tmp_path, fmi)
    kind, state, thaw = (
        ("Real", "FMUstate", "deSerializeFMUstate")
        if fmi == 2
        else ("Float64", "FMUState", "deserializeFMUState")
    )
    get, put = getattr(slave, f"get{kind}"), getattr(slave, f"set{kind}")
    take_back = getattr(slave, f"set{state}")
    outputs = [reference[name] for name in case.simulated.names]
    begin(slave, fmi)
    put([reference["speed_rpm"], reference["load_n"]], [3000.0, 2000.0])
    slave.doStep(0.0, 600.0)
    kept = getattr(slave, f"get{state}")()
    frozen = getattr(slave, f"serialize{state}")(kept)
    slave.doStep(600.0, 600.0)
    first = get(outputs)
    for again in (kept, getattr(slave, thaw)(frozen)):
        put([reference["speed_rpm"]], [5000.0])
        slave.doStep(1200.0, 60.0)
        take_back(again)
        slave.doStep(600.0, 600.0)
        assert get(outputs) == first
    slave.reset()
    assert get(outputs) == pytest.approx([20.0] * len(outputs), abs=1e-12)
    slave.freeInstance()


@pytest.mark.parametrize("fmi", [2, 3])
def test_what_makes_no_sense_is_refused_and_said(
    case: Case, fmi: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    slave, reference = unpacked(case.fmus[fmi], tmp_path / "right", fmi)
    put = slave.setReal if fmi == 2 else slave.setFloat64
    begin(slave, fmi)
    output = reference[case.simulated.names[0]]
    for call, said in (
        (lambda: put([reference["speed_rpm"]], [np.nan]), "expected a finite number"),
        (lambda: put([output], [5.0]), "cannot be set"),
        (lambda: put([reference["initial_temperature_c"]], [5.0]), "before the start only"),
        (lambda: put([8888], [5.0]), "8888: cannot be set"),
        (lambda: slave.doStep(0.0, -1.0), "expected 0 s or more"),
    ):
        with pytest.raises(FMICallException):
            call()
        assert said in capfd.readouterr().out
    # The refused values changed nothing.
    slave.doStep(0.0, 60.0)
    slave.freeInstance()
    stranger, _ = unpacked(case.fmus[fmi], tmp_path / "wrong", fmi, "{another model}")
    with pytest.raises(Exception, match=r"(?i)instantiate"):
        stranger.instantiate()
    assert "of another model" in capfd.readouterr().out


@pytest.mark.parametrize("case", ["drive"], indirect=True)
def test_a_machine_that_runs_away_is_an_error(
    case: Case, capfd: pytest.CaptureFixture[str]
) -> None:
    hot = np.array([1500.0] * 2), np.array([1000.0] * 2), np.array([20.0] * 2)
    rows = PlannedRows(np.array([0.0, DAY_S]), *hot, np.array([[20.0, 4000.0, 0.0]] * 2))
    with pytest.raises(FMICallException):
        case.run(2, rows=rows, fmi_type="CoSimulation")
    assert "run away" in capfd.readouterr().out


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("case", ["default"], indirect=True)
@pytest.mark.parametrize("factor", [1e6, 1e-6])
def test_absurd_parameters_are_refused_after_a_bounded_number_of_steps(
    case: Case, fmi: int, factor: float, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    slave, reference = unpacked(case.fmus[fmi], tmp_path, fmi)
    begin(slave, fmi)
    put = slave.setReal if fmi == 2 else slave.setFloat64
    get = slave.getReal if fmi == 2 else slave.getFloat64
    put([reference["speed_rpm"], reference["load_n"]], [6000.0, 4000.0])
    refused = 0
    for name in case.identified.model.parameters.names:
        one = reference[f"parameter.{name}"]
        (before,) = get([one])
        kept = slave.getFMUState()
        put([one], [before * factor])
        began_s = time.process_time()
        try:
            slave.doStep(0.0, 600.0)
        except FMICallException:
            refused += 1
            said = capfd.readouterr().out
            expected = "too fast to be followed", "run away", "parameters out of range"
            assert any(one in said for one in expected), (name, said)
        assert time.process_time() - began_s < 5.0, f"{name} is crawled through"
        slave.setFMUState(kept)
        slave.freeFMUState(kept)
    assert refused > 0
    slave.doStep(0.0, 600.0)
    slave.freeInstance()


def test_the_commands_agree_and_equal_models_give_equal_files(
    prior_model: Path, command: Callable[..., Any], tmp_path: Path
) -> None:
    needed("gcc libc6-dev", "cc")
    profile = steps_file(
        tmp_path / "profile.csv", [[0, 3000, 2650, 20], [3600, 5000, 4000, 22], [7200, 0, 0, 22]]
    )
    command(
        "simulate", prior_model, "--profile", profile, "--initial-temperature-c", 25,
        "--out", tmp_path / "out.csv",
    )  # fmt: skip
    command("export-fmu", prior_model, "--out", tmp_path / "a.fmu")
    command("export-fmu", prior_model, "--out", tmp_path / "b.fmu", "--fmi", 2)
    assert (tmp_path / "a.fmu").read_bytes() == (tmp_path / "b.fmu").read_bytes()
    expected = read(tmp_path / "out.csv")
    rows = PlannedRows(
        expected["time_s"], np.array([3000.0, 5000, 0]), np.array([2650.0, 4000, 0]),
        np.array([20.0, 22, 22]),
    )  # fmt: skip
    result = run_fmu(
        tmp_path / "a.fmu", rows, OPERATION, (), fmi_type="CoSimulation",
        start_values={"initial_temperature_c": 25.0},
    )  # fmt: skip
    for name in ("t_inner_ring_c", "t_outer_ring_c", "t_node_7_c"):
        np.testing.assert_allclose(result[name][[0, 60, 120]], expected[name], rtol=0.0, atol=1e-6)
    assert signals(rows, OPERATION, ()).size == 4


def test_what_cannot_be_exported_is_refused(
    prior_model: Path,
    complaint: Callable[..., str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "model.fmu"
    assert complaint("export-fmu", prior_model, "--out", out, "--fmi", 1) == (
        "--fmi 1: expected 2 or 3"
    )
    said = complaint("export-fmu", prior_model, "--out", tmp_path / "none" / "model.fmu")
    assert "expected a file in an existing folder" in said
    text = DRIVE.replace("coolant_c", "initial_temperature_c")
    identified_model(own_model(text, tmp_path), 1).save(tmp_path / "taken.json")
    said = complaint("export-fmu", tmp_path / "taken.json", "--out", out)
    assert "the name 'initial_temperature_c' is taken in an FMU" in said
    with monkeypatch.context() as patch:
        patch.setattr("service.offline.fmu.tables.EXPORTED_EDGES", ())
        said = complaint("export-fmu", prior_model, "--out", out)
        assert said == "network 'default': no FMU with edges CONSTANT"
    monkeypatch.setenv("PATH", str(tmp_path))
    said = complaint("export-fmu", prior_model, "--out", out)
    assert said.startswith("no C compiler: the program 'cc' is not found; expected one")
    assert not out.exists()
