"""Import and export, on real files and a real store, through the command line's functions."""

import json
import math
import random
import shutil
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from site_files import asset_text
from typer.testing import CliRunner

from adapters.samples import Sample
from service.cli.main import app
from service.clock import from_rfc3339, rfc3339, rfc3339_exact
from service.store import Store

from .conftest import CONFIG, Run, stored

START = "2026-03-01T12:00:00Z"
START_US = from_rfc3339(START)
HEADER = "time,speed_rpm,load_n,ambient_c,t_inner_ring_c,t_outer_ring_c"


def database(tmp_path: Path, *arguments: str) -> dict[str, Any]:
    options = ["-c", str(tmp_path / "c.toml"), "--json"]
    found: dict[str, Any] = json.loads(CliRunner().invoke(app, ["db", *arguments, *options]).stdout)
    return found


def received_us(tmp_path: Path) -> list[int | None]:
    with Store.open("", tmp_path / "data") as store:
        return [row.received_us for row in store.samples.read("a", None, 0, 2**62, 10**6)]


def test_a_received_time_may_be_missing_but_not_wrong(tmp_path: Path, run: Run) -> None:
    header = "time,channel,value,received"
    rows = [
        f"{START},speed_rpm,{k},{cell}" for k, cell in enumerate(("soon", "1969-01-01T00:00:00Z"))
    ]
    rows.append(f"{START},load_n,3,")
    status, report, text = run("import", table(tmp_path, *rows, header=header))
    assert (status, report["stored"], report["rejected"]) == (2, 1, 2)
    assert "line 2: received: " in text
    assert "line 3: received: 1969-01-01T00:00:00.000Z: expected a time from 1990" in text


def table(tmp_path: Path, *rows: str, header: str = HEADER) -> Path:
    path = tmp_path / "data.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8-sig")
    return path


def test_a_table_is_stored_once_however_often_it_is_imported(tmp_path: Path, run: Run) -> None:
    path = table(
        tmp_path,
        f"{START},1500,2650,21.5,40.1,38.2",
        "2026-03-01T13:00:01+01:00,1500,,21.5,40.2,",
        "",
    )
    dry = run("import", path, "--dry-run")[1]
    assert (dry["rows"], dry["samples"], dry["stored"]) == (2, 8, 0)
    assert stored(tmp_path) == []
    status, report, _ = run("import", path)
    assert (status, report["stored"], report["duplicates"], report["rejected"]) == (0, 8, 0, 0)
    assert run("import", path)[1]["duplicates"] == 8
    rows = stored(tmp_path)
    assert ("load_n", START_US, 2650.0, 192) in rows
    assert ("t_inner_ring_c", START_US + 1_000_000, 40.2, 192) in rows
    assert len(rows) == 8


def test_bad_rows_and_cells_are_told_with_their_lines_and_the_rest_is_stored(
    tmp_path: Path, run: Run
) -> None:
    path = table(
        tmp_path,
        f"{START},1500,2650,21.5,40.1,38.2",
        "yesterday,1500,2650,21.5,40.1,38.2",
        "2026-03-01T12:00:02Z,1500,2650,21.5,40.1",
        "2026-03-01T12:00:03Z,fast,2650,21.5,3276.7,nan",
        "2026-03-01T12:00:04,1500,2650,21.5,40.1,38.2",
    )
    status, report, errors = run("import", path)
    assert status == 2
    assert (report["rows"], report["samples"], report["rejected"]) == (5, 7, 6)
    told = {(one["line"], one["detail"].partition(":")[0]) for one in report["errors"]}
    assert told == {
        (3, "time"),
        (4, "5 cells; expected 6"),
        (5, "speed_rpm = 'fast'"),
        (5, "t_inner_ring_c = 3276.7"),
        (5, "t_outer_ring_c = 'nan'"),
        (6, "time"),
    }
    assert "data.csv: line 3: time: time 'yesterday': expected RFC 3339" in errors
    assert len(stored(tmp_path)) == 7


@pytest.mark.parametrize(
    ("header", "complaint"),
    [
        (HEADER.replace(",load_n", ""), "line 1: missing column 'load_n'"),
        (HEADER + ",t_gear_c", "line 1: unknown column 't_gear_c'"),
        (HEADER + ",load_n", "line 1: column 'load_n' occurs twice"),
        (HEADER.replace("time,", ""), "missing column time or time_s"),
        (HEADER.replace("time,", "time_s,"), "expected --start"),
        ("time,channel,value,colour", "unknown column 'colour'"),
        ("", "line 1: "),
    ],
)
def test_a_header_that_cannot_be_used_is_one_line_and_stores_nothing(
    tmp_path: Path, run: Run, header: str, complaint: str
) -> None:
    status, _, text = run("import", table(tmp_path, "0,1,2,3,4,5", header=header))
    assert status == 2
    assert complaint in text
    assert "\n" not in text
    assert stored(tmp_path) == []


def test_seconds_count_from_a_given_start(tmp_path: Path, run: Run) -> None:
    path = table(tmp_path, "0.5,1500,2650,21,40,38", header=HEADER.replace("time", "time_s"))
    assert run("import", path, "--start", START)[0] == 0
    assert {row[1] for row in stored(tmp_path)} == {START_US + 500_000}


def test_a_mapping_names_scales_and_shifts_columns(tmp_path: Path, run: Run) -> None:
    mapping = tmp_path / "m.toml"
    mapping.write_text(
        'delimiter = ";"\n[time]\ncolumn = "timestamp_utc"\n'
        '[channels.speed_rpm]\ncolumn = "gen_rpm"\n'
        '[channels.t_node_5_c]\ncolumn = "bearing_f"\nscale = 0.5555555555555556\n'
        "offset = -17.77777777777778\n"
    )
    path = tmp_path / "farm.csv"
    path.write_text(f"timestamp_utc;gen_rpm;other;bearing_f\n{START};1200;x;212\n")
    assert run("import", path, "--mapping", mapping)[0] == 0
    assert stored(tmp_path) == [
        ("speed_rpm", START_US, 1200.0, 192),
        ("t_node_5_c", START_US, pytest.approx(100.0), 192),
    ]
    mapping.write_text(mapping.read_text().replace("bearing_f", "bearing_k"))
    assert "missing column 'bearing_k'" in run("import", path, "--mapping", mapping)[2]
    mapping.write_text('[time]\ncolumn = "t"\n[channels.speed_rpm]\nscale = 2\n')
    assert "channels.speed_rpm.column: missing" in run("import", path, "--mapping", mapping)[2]


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_what_is_exported_can_be_imported_again(tmp_path: Path, run: Run, suffix: str) -> None:
    dice = random.Random(3)
    samples = [
        Sample(
            "a",
            dice.choice(["t_inner_ring_c", "phase", "t_inner_ring_c.twin"]),
            START_US + k * 137_000,
            dice.choice([dice.uniform(20, 80), math.nan]),
            dice.choice([0, 24, 64, 192, 216]),
            START_US + k * 137_000 + dice.randrange(10**6),
        )
        for k in range(500)
    ]
    with Store.open("", tmp_path / "data") as store:
        store.samples.write(samples)
    before, received = stored(tmp_path), received_us(tmp_path)
    out, full = tmp_path / f"out.{suffix}", tmp_path / f"full.{suffix}"
    assert run("export", "--out", out)[1]["rows"] == 500
    assert run("export", "--out", full, "--received")[1]["rows"] == 500
    for number, file in enumerate((out, full)):
        (tmp_path / "data").rename(tmp_path / f"elsewhere-{number}")
        status, report, _ = run("import", file)
        assert (status, report["stored"]) == (0, 500)
        assert stored(tmp_path) == before
        found = received_us(tmp_path)
        assert (found == received) == (file == full)
        assert (len(set(found)) == 1) == (file == out), "when it was imported"


def test_parquet_carries_units_and_the_rollups_their_extremes(tmp_path: Path, run: Run) -> None:
    with Store.open("", tmp_path / "data") as store:
        store.samples.write(
            [
                Sample("a", name, START_US + k * 10_000_000, float(k), 192, 0)
                for k in range(12)
                for name in ("t_inner_ring_c", "speed_rpm")
            ]
        )
    out = tmp_path / "out.parquet"
    report = run("export", "--out", out, "--resolution", "1min", "--channel", "speed_rpm")[1]
    assert report["rows"] == 2
    file = pq.read_table(out)
    assert file.schema.metadata[b"unit:speed_rpm"] == b"rpm"
    assert file.schema.field("time").type == pa.timestamp("us", tz="UTC")
    assert file.to_pylist()[0]["max"] == 5.0
    assert file.to_pylist()[0]["count"] == 6


def test_minutes_are_what_identify_reads(tmp_path: Path, run: Run) -> None:
    with Store.open("", tmp_path / "data") as store:
        store.samples.write(
            [
                Sample("a", name, START_US + k * 1_000_000, float(k // 60), 192, 0)
                for k in range(180)
                for name in HEADER.split(",")[1:]
            ]
        )
    out = tmp_path / "minutes.csv"
    assert run("export", "--out", out, "--resolution", "minutes")[0] == 0
    lines = out.read_text().splitlines()
    assert lines[0] == HEADER
    assert lines[2] == f"{rfc3339(START_US + 60_000_000)},1,1,1,0.5,0.5"


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--out", "x.xls"), "expected a name that ends in .csv, .parquet or .mf4"),
        (("--out", "x.csv", "--channel", "t_gear_c"), "--channel t_gear_c"),
        (("--out", "x.csv", "--resolution", "2s3"), "--resolution 2s3"),
        (("--out", "x.csv", "--start", "now"), "--start: time 'now'"),
        (("--out", "x.csv", "--received", "--resolution", "1min"), "--received: expected"),
        (("--out", "x.csv", "--start", START, "--end", START), "--end"),
    ],
)
def test_a_wrong_option_is_named(
    tmp_path: Path,
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    complaint: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    status, _, text = run("export", *arguments)
    assert status == 2
    assert complaint in text
    assert list(tmp_path.glob("x.*")) == []


def test_an_asset_that_is_not_configured_is_named(tmp_path: Path) -> None:
    config = tmp_path / "c.toml"
    config.write_text(CONFIG)
    path = table(tmp_path, f"{START},1500,2650,21.5,40.1,38.2")
    result = CliRunner().invoke(app, ["import", str(path), "-c", str(config), "--asset", "b"])
    assert "--asset b: no such asset; expected one of a" in str(result.exception)


def test_an_asset_with_its_own_network_has_its_own_columns(tmp_path: Path) -> None:
    config = tmp_path / "c.toml"
    networks = Path(__file__).parents[3] / "deploy" / "networks"
    network = f'network = "{networks / "gearbox.toml"}"'
    columns = ("speed_rpm", "load_n", "ambient_c", "t_bearing_c")
    text = asset_text("g", columns, machine=network, low_risk=(1000, 3000))
    config.write_text('[service]\ndata_dir = "data"\n' + text)

    def run(path: Path) -> str:
        arguments = ["import", str(path), "-c", str(config), "--asset", "g"]
        result = CliRunner().invoke(app, arguments)
        return str(result.exception or result.stdout)

    header = "time,speed_rpm,load_n,ambient_c,t_bearing_c"
    assert "4 stored" in run(table(tmp_path, f"{START},1500,2650,21.5,40.1", header=header))
    wrong = table(tmp_path, f"{START},1500,2650,21.5,40.1", header=HEADER)
    assert "missing column 't_bearing_c'" in run(wrong)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_samples_some_microseconds_apart_survive_export_and_import(
    tmp_path: Path, run: Run, suffix: str
) -> None:
    # Frames of a CAN bus that a busy service reads in one go.
    frames = [Sample("a", "load_n", START_US + 30 * k, 1000.0 + k, 192, 0) for k in range(2000)]
    with Store.open("", tmp_path / "data") as store:
        assert store.samples.write(frames) == (2000, 0)
    before = stored(tmp_path)
    out = tmp_path / f"frames{suffix}"
    status, report, _ = run("export", "--out", out)
    assert (status, report["rows"]) == (0, 2000)
    shutil.rmtree(tmp_path / "data")
    status, report, _ = run("import", out)
    assert (status, report["stored"], report["duplicates"]) == (0, 2000, 0)
    assert stored(tmp_path) == before
    # The span is exact too.
    part = tmp_path / f"part{suffix}"
    begin, end = rfc3339_exact(START_US + 30), rfc3339_exact(START_US + 120)
    status, report, _ = run("export", "--out", part, "--start", begin, "--end", end)
    assert (status, report["rows"]) == (0, 3)


def test_what_is_not_configured_any_more_can_be_exported(tmp_path: Path, run: Run) -> None:
    with Store.open("", tmp_path / "data") as store:
        store.samples.write([Sample("old", "load_n", START_US, 1.0, 192, 0)])
    out = tmp_path / "old.csv"
    config = tmp_path / "c.toml"
    arguments = ["export", "--out", str(out), "-c", str(config), "--asset"]
    assert CliRunner().invoke(app, [*arguments, "old"]).exit_code == 0
    assert out.read_text().splitlines()[1] == "2026-03-01T12:00:00.000Z,load_n,1.0,192"
    refused = CliRunner().invoke(app, [*arguments, "older"])
    assert "--asset older: no such asset; expected one of a, old" in str(refused.exception)


def test_progress_is_shown_without_a_terminal(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.cli.transfer._PROGRESS_S", 0.0)
    rows = [f"2026-03-01T12:{k // 60:02}:{k % 60:02}Z,1500,2650,21.5,40.1,38.2" for k in range(60)]
    status, _, text = run("import", table(tmp_path, *rows))
    assert status == 0
    assert "import data.csv: 100 %" in text


def test_a_time_that_comes_again_with_another_value_is_named(tmp_path: Path, run: Run) -> None:
    rows = [f"2026-03-01T12:00:0{second}Z,1500,2650,21,4{second},40" for second in (0, 1, 1, 2)]
    rows[2] = rows[2].replace("41,40", "71,40")
    file = table(tmp_path, *rows)
    said = "t_inner_ring_c = 71 at 2026-03-01T12:00:01.000Z: same time, another value: not taken; "
    dry = run("import", file, "--dry-run")[1]
    assert [one["line"] for one in dry["errors"]] == [4]
    status, report, error = run("import", file)
    assert (status, report["samples"], report["stored"]) == (2, 20, 15)
    assert (report["duplicates"], report["rejected"]) == (4, 1), "the other four say the same"
    assert report["errors"] == [{"line": 4, "detail": f"{said}41 is stored"}]
    assert f"line 4: {said}" in error
    # Of another file, too; what says the same is already stored.
    other = table(tmp_path, rows[2], rows[3])
    status, report, _ = run("import", other)
    assert (status, report["stored"], report["duplicates"], report["rejected"]) == (2, 0, 9, 1)


def test_a_value_for_a_bad_sample_is_taken(tmp_path: Path, run: Run) -> None:
    header = "time,channel,value,quality"
    lines = ["2026-03-01T12:00:00Z,speed_rpm,,0", "2026-03-01T12:00:00Z,speed_rpm,1500,192"]
    status, report, _ = run("import", table(tmp_path, *lines, header=header))
    assert (status, report["rejected"]) == (0, 0)
    assert [row[2] for row in stored(tmp_path)] == [1500.0]


@pytest.mark.parametrize("suffix", ["csv", "parquet", "mf4", "minutes"])
def test_samples_of_impossible_times_are_told_and_not_exported(
    tmp_path: Path, run: Run, suffix: str
) -> None:
    strange_us = (1_764_230_400_000, 1_764_230_400_000_000_000, START_US)
    with Store.open("", tmp_path / "data") as store:
        store.samples.write([Sample("a", "speed_rpm", one, 1500.0, 192, 0) for one in strange_us])
    out = tmp_path / f"out.{suffix.replace('minutes', 'csv')}"
    options = ("--resolution", "minutes") if suffix == "minutes" else ()
    status, report, text = run("export", "--out", out, *options)
    assert (status, report["rows"]) == (0, 1)
    assert "2 samples of times before 1990 or after tomorrow are not exported" in text
    text = run("export", "--out", tmp_path / "all.csv", "--start", "1970-01-01T00:00:00Z")[2]
    assert "'bearing-twin db times' lists and removes them" in text
    listed = database(tmp_path, "times")
    assert (listed["removed"], [one["samples"] for one in listed["items"]]) == (0, [2])
    assert listed["items"][0]["first"] == "1970-01-21T10:03:50.400Z"
    assert listed["items"][0]["last"] == "9999-12-31T23:59:59.999Z"
    assert database(tmp_path, "times", "--remove")["removed"] == 2
    assert database(tmp_path, "times") == {"items": [], "removed": 0}
    assert [row[1] for row in stored(tmp_path)] == [START_US]
