"""A recording in another unit is named before the fit, and so is a forecast of it."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from service.cli.main import app

from .files import HEADER, Run, steps_file, write

Complaint = Callable[..., str]
QUICK = ("--bearing", "6311", "--method", "refine")
KN = r"load_n: 2\.\d+ at 2\d+ rpm; expected 45 N or more, 0.1 % of the static load rating; kN\?"


def changed(run: Run, tmp_path: Path, column: str, scale: float, offset: float = 0.0) -> Path:
    rows = run.rows(60)
    place = HEADER.index(column)
    rows[:, place] = rows[:, place] * scale + offset
    return write(tmp_path / "run.csv", rows)


def test_a_load_in_kilonewtons_is_identified_and_not_accepted(run: Run, tmp_path: Path) -> None:
    data, model = changed(run, tmp_path, "load_n", 1e-3), tmp_path / "m.json"
    arguments = ["identify", data, *QUICK, "--at-rest", "--out", model, "--json"]
    result = CliRunner().invoke(app, [str(one) for one in arguments])
    assert result.exit_code == 0, result.output
    first = result.stderr.splitlines()[0]
    assert re.fullmatch(f"bearing-twin: warning: run.csv: {KN}", first)
    text = first.removeprefix("bearing-twin: warning: run.csv: ")
    found = json.loads(result.stdout)
    assert found["gates"]["accepted"] is False
    assert re.match(KN, found["gates"]["reason"])
    assert found["warnings"][0] == f"run.csv: {text}"

    profile = steps_file(
        tmp_path / "p.csv", [(0.0, 4200.0, 5.5, 23.0), (3600.0, 4200.0, 5.5, 23.0)]
    )
    arguments = ["forecast", model, "--history", data, "--profile", profile]
    arguments += ["--out", tmp_path / "f.csv", "--json"]
    result = CliRunner().invoke(app, [str(one) for one in arguments])
    labels = json.loads(result.stdout)["labels"]
    assert labels[0] == f"run.csv: {text}"
    assert labels[1].startswith("p.csv: load_n: 5.5 at 4200 rpm; ")


@pytest.mark.parametrize(
    ("column", "scale", "offset", "expected"),
    [
        ("ambient_c", 1.0, 273.15, "; expected -60 to 60 °C; kelvin?"),
        ("t_outer_ring_c", 1.0, 273.15, "and more; expected a start below 200 °C; kelvin?"),
        ("time_s", 1000.0, 0.0, "time_s: rows 60000 s apart, 16.7 h; expected minutes; ms?"),
    ],
)
def test_what_no_machine_has_is_refused_before_the_fit(
    run: Run,
    tmp_path: Path,
    complaint: Complaint,
    column: str,
    scale: float,
    offset: float,
    expected: str,
) -> None:
    data = changed(run, tmp_path, column, scale, offset)
    assert expected in complaint("identify", data, *QUICK, "--out", tmp_path / "m.json")
    assert not (tmp_path / "m.json").exists()


def test_a_history_and_a_profile_in_kelvin_are_refused(
    run: Run, tmp_path: Path, complaint: Complaint, prior_model: Path
) -> None:
    right = [(0.0, 4200.0, 5500.0, 23.0), (3600.0, 4200.0, 5500.0, 23.0)]
    profile = steps_file(tmp_path / "p.csv", right)
    data = changed(run, tmp_path, "ambient_c", 1.0, 273.15)
    out = tmp_path / "f.csv"
    text = complaint("forecast", prior_model, "--history", data, "--profile", profile, "--out", out)
    assert text.endswith("kelvin?")
    kelvin = np.array(right) + np.array([0.0, 0.0, 0.0, 273.15])
    profile = steps_file(tmp_path / "p.csv", kelvin.tolist())
    for name in ("forecast", "simulate"):
        cold = ("--initial-temperature-c", 23)
        text = complaint(name, prior_model, *cold, "--profile", profile, "--out", out)
        assert text == "p.csv: ambient_c: 296.1; expected -60 to 60 °C; kelvin?"
    assert not out.exists()
