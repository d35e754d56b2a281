"""Units that a file states are converted as it is imported."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from service.cli.main import app

from .conftest import Run, stored

HEADINGS = {
    "speed_rpm": ("Speed [1/s]", 25.0, 1500.0),
    "load_n": ("Load [kN]", 2.65, 2650.0),
    "ambient_c": ("Ambient (K)", 296.15, 23.0),
    "t_inner_ring_c": ("Inner [°F]", 104.0, 40.0),
    "t_outer_ring_c": ("Outer (left)", 38.0, 38.0),
}
CONVERSIONS = [
    "speed_rpm: '1/s' × 60 -> rpm",
    "load_n: 'kN' × 1000 -> N",
    "ambient_c: 'K' - 273.15 -> °C",
    "t_inner_ring_c: '°F' × 0.5555555556 - 17.77777778 -> °C",
]
TIME = "2026-03-01T12:00:00Z"


def mapping(tmp_path: Path, columns: dict[str, str], more: str = "") -> Path:
    path = tmp_path / "m.toml"
    channels = "".join(f'[channels.{one}]\ncolumn = "{name}"\n' for one, name in columns.items())
    path.write_text(f'[time]\ncolumn = "time"\n{channels}{more}', encoding="utf-8")
    return path


def test_units_in_the_headings_of_a_csv_file(tmp_path: Path, run: Run) -> None:
    names = {channel: heading for channel, (heading, _, _) in HEADINGS.items()}
    path = tmp_path / "run.csv"
    cells = ",".join(str(value) for _, value, _ in HEADINGS.values())
    path.write_text(f"time,{','.join(names.values())}\n{TIME},{cells}\n", encoding="utf-8")
    status, report, _ = run("import", path, "--mapping", mapping(tmp_path, names))
    assert (status, report["conversions"]) == (0, CONVERSIONS)
    found = {name: value for name, _, value, _ in stored(tmp_path)}
    assert found == pytest.approx({name: ours for name, (_, _, ours) in HEADINGS.items()})


def test_a_scale_of_the_mapping_counts_and_a_strange_unit_is_refused(
    tmp_path: Path, run: Run
) -> None:
    names = {name: heading for name, (heading, _, _) in HEADINGS.items()} | {"load_n": "Load [t]"}
    path = tmp_path / "run.csv"
    path.write_text(f"time,{','.join(names.values())}\n{TIME},25,2,296,104,38\n", encoding="utf-8")
    status, _, text = run("import", path, "--mapping", mapping(tmp_path, names))
    assert status == 2
    assert "column 'Load [t]' is in 't'; expected N, daN, kN, lbf for load_n" in text
    assert stored(tmp_path) == []
    names.pop("load_n")
    scaled = '[channels.load_n]\ncolumn = "Load [t]"\nscale = 9806.65\n'
    status, report, _ = run("import", path, "--mapping", mapping(tmp_path, names, scaled))
    assert status == 0
    assert "load_n: 't' × 9806.65 -> N (scale and offset of the mapping)" in report["conversions"]
    assert ("load_n", 19613.3) in {(name, value) for name, _, value, _ in stored(tmp_path)}


def test_units_in_the_metadata_of_parquet_columns(tmp_path: Path, run: Run) -> None:
    units = {"ambient_c": b"K", "load_n": b"kN"}
    time = pa.field("time", pa.timestamp("us", tz="UTC"))
    fields = [
        pa.field(name, pa.float64(), metadata={b"unit": units[name]} if name in units else None)
        for name in HEADINGS
    ]
    given = {name: given if name in units else ours for name, (_, given, ours) in HEADINGS.items()}
    columns = [pa.array([1_772_366_400_000_000], time.type)]
    columns += [pa.array([value]) for value in given.values()]
    table = pa.Table.from_arrays(columns, schema=pa.schema([time, *fields]))
    path = tmp_path / "run.parquet"
    pq.write_table(table, path)
    status, report, _ = run("import", path)
    assert (status, report["conversions"]) == (0, [CONVERSIONS[1], CONVERSIONS[2]])
    found = {name: value for name, _, value, _ in stored(tmp_path)}
    assert found == pytest.approx({name: ours for name, (_, _, ours) in HEADINGS.items()})


def test_a_unit_that_the_mapping_overrules_is_said(tmp_path: Path, run: Run) -> None:
    names = {name: name for name in HEADINGS if name != "load_n"}
    path = tmp_path / "run.csv"
    path.write_text(f"time,{','.join(names)},Load [kN]\n{TIME},1500,21,40,38,2650\n")
    scaled = '[channels.load_n]\ncolumn = "Load [kN]"\nscale = 1\n'
    status, report, _ = run("import", path, "--mapping", mapping(tmp_path, names, scaled))
    assert status == 0
    assert report["conversions"] == ["load_n: 'kN' × 1 -> N (scale and offset of the mapping)"]


KELVIN_OR_TYPE = "(K) is kelvin or the type of a thermocouple; expected in the mapping "


@pytest.mark.parametrize(
    "heading", ["TC3 (K)", "T/C 3 (K)", "tc_inner (K)", "Thermocouple type K (K)", "Typ K (K) "]
)
def test_the_type_of_a_thermocouple_is_no_unit(tmp_path: Path, run: Run, heading: str) -> None:
    names = {name: name for name in HEADINGS if name != "t_inner_ring_c"}
    path = tmp_path / "run.csv"
    path.write_text(f"time,{','.join(names.values())},{heading}\n{TIME},1500,2650,21,38,240\n")
    ring = f'[channels.t_inner_ring_c]\ncolumn = "{heading.strip()}"\n'
    text = run("import", path, "--mapping", mapping(tmp_path, names, ring))[2]
    assert f"run.csv: column '{heading.strip()}' of t_inner_ring_c: {KELVIN_OR_TYPE}" in text
    assert "expected in the mapping scale = 1 for °C, or offset = -273.15 for kelvin" in text
    assert stored(tmp_path) == []
    plan = mapping(tmp_path, names, ring + "scale = 1\n")
    assert run("import", path, "--mapping", plan)[0] == 0
    assert ("t_inner_ring_c", 240.0) in {(name, value) for name, _, value, _ in stored(tmp_path)}


def test_the_metadata_of_a_column_settle_the_unit_of_a_thermocouple(
    tmp_path: Path, run: Run
) -> None:
    time = pa.field("time", pa.timestamp("us", tz="UTC"))
    names = {name: name for name in HEADINGS if name != "t_inner_ring_c"}
    fields = [time, *(pa.field(name, pa.float64()) for name in names)]
    fields += [pa.field("TC3 (K)", pa.float64(), metadata={b"unit": b"K"})]
    columns = [pa.array([1_772_366_400_000_000], time.type)]
    columns += [pa.array([value]) for value in (1500.0, 2650.0, 21.0, 38.0, 313.15)]
    path = tmp_path / "run.parquet"
    pq.write_table(pa.Table.from_arrays(columns, schema=pa.schema(fields)), path)
    plan = mapping(tmp_path, names | {"t_inner_ring_c": "TC3 (K)"})
    status, report, _ = run("import", path, "--mapping", plan)
    assert (status, report["conversions"]) == (0, ["t_inner_ring_c: 'K' - 273.15 -> °C"])


def test_a_person_reads_one_line_for_each_conversion(tmp_path: Path, config: Path) -> None:
    names = {channel: heading for channel, (heading, _, _) in HEADINGS.items()}
    path = tmp_path / "run.csv"
    cells = ",".join(str(value) for _, value, _ in HEADINGS.values())
    path.write_text(f"time,{','.join(names.values())}\n{TIME},{cells}\n", encoding="utf-8")
    options = ["--mapping", mapping(tmp_path, names), "--asset", "a", "-c", config, "--dry-run"]
    result = CliRunner().invoke(app, ["import", *map(str, [path, *options])])
    assert result.stdout.splitlines()[1:] == [f"run.csv: {one}" for one in CONVERSIONS]
