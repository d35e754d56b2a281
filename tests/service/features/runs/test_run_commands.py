"""Runs and their reports on the command line."""

import csv
import json
from pathlib import Path

import pytest
from site_files import asset_text
from typer.testing import CliRunner

from service.cli.main import app
from service.store import AuditEntry, Store
from tests.service.features.runs.conftest import START_US, fill, section

CONFIGURATION = (
    asset_text("bench-1", ("speed_rpm", "load_n", "t_inner_ring_c"))
    + "[assets.limits]\nt_inner_ring_c = { warning = 70, alarm = 80 }\n"
)


def test_a_run_is_listed_and_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("c.toml").write_text(CONFIGURATION)

    def call(*arguments: str) -> tuple[int, str]:
        result = CliRunner().invoke(app, [*arguments, "-c", "c.toml"])
        return result.exit_code, result.output + str(result.exception or "")

    assert call("runs", "bench-1") == (0, "bench-1: no run is stored.\n")
    assert "no run is stored" in call("report", "bench-1", "--out", "r.pdf")[1]
    with Store.open("", tmp_path / "var") as store:
        end_us = fill(store, section(nodes=0), 1.0, every_s=20)
    status, printed = call("runs", "bench-1", "--json")
    (run,) = json.loads(printed)["items"]
    assert (status, run["ended"], run["duration_s"]) == (0, "standstill", (end_us - START_US) / 1e6)
    assert run["id"] in call("runs", "bench-1")[1]
    for out, begin in (("r.pdf", b"%PDF-"), ("r.png", b"\x89PNG"), ("r.csv", b"\xef\xbb\xbfRun")):
        assert call("report", "bench-1", "--out", out)[0] == 0
        assert Path(out).read_bytes().startswith(begin)
        again = f"again-{out}"
        assert call("report", "bench-1", "--out", again, "--run", run["id"])[0] == 0
        assert Path(again).read_bytes() == Path(out).read_bytes()
    assert "expected one of last, " in call("report", "bench-1", "--out", "r.pdf", "--run", "x")[1]
    assert "ends in .pdf, .png or .csv" in call("report", "bench-1", "--out", "r.doc")[1]
    assert "no such asset" in call("runs", "bench-2")[1]


def test_a_report_has_the_limits_of_the_end_of_its_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("c.toml").write_text(CONFIGURATION)

    def limits() -> list[str]:
        report = CliRunner().invoke(app, ["report", "bench-1", "--out", "r.csv", "-c", "c.toml"])
        assert report.exit_code == 0, report.output
        rows = csv.reader(Path("r.csv").read_text(encoding="utf-8-sig").splitlines())
        return next(row[5:7] for row in rows if "Inner ring" in row and len(row) > 8)

    def change(setpoint: float, at_us: int) -> None:
        with Store.open("", tmp_path / "var") as store:
            line = AuditEntry(at_us, "engineer", "", "a.b", "", "")
            name = ("measured limit", "t_inner_ring_c", "warning")
            settings = store.alarm_overlays
            changes = {("bench-1", name): {"setpoint": setpoint}}
            settings.change(changes, line, "", settings.revision())

    with Store.open("", tmp_path / "var") as store:
        end_us = fill(store, section(nodes=0), 1.0, every_s=20)
    assert limits() == ["70.0", "80.0"]
    change(65.0, end_us - 1)
    assert limits() == ["65.0", "80.0"]
    report = Path("r.csv").read_bytes()
    change(75.0, end_us + 1)
    assert limits() == ["65.0", "80.0"]
    assert Path("r.csv").read_bytes() == report
