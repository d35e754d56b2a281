"""Times of files: only what says that it is a time is one, and one that can be."""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from service.clock import ProcessClock, from_rfc3339, rfc3339

from .conftest import Run, stored

START = "2026-03-01T12:00:00.000Z"
START_US = from_rfc3339(START)
HEADER = "time,speed_rpm,load_n,ambient_c,t_inner_ring_c,t_outer_ring_c"
VALUES = {
    "speed_rpm": [1500.0],
    "load_n": [2650.0],
    "ambient_c": [21.0],
    "t_inner_ring_c": [40.0],
    "t_outer_ring_c": [38.0],
}
UTC_STAMPS = "expected a time stamp with a time zone, or a mapping with the unit"


def parquet(tmp_path: Path, times: pa.Array, name: str = "time") -> Path:
    path = tmp_path / "run.parquet"
    pq.write_table(pa.table({name: times, **VALUES}), path)
    return path


def table(tmp_path: Path, *rows: str, header: str = HEADER) -> Path:
    path = tmp_path / "data.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def mapping(tmp_path: Path, time: str, more: str = "") -> Path:
    path = tmp_path / "m.toml"
    channels = "".join(f'[channels.{name}]\ncolumn = "{name}"\n' for name in VALUES)
    path.write_text(f'{more}\n[time]\ncolumn = "time"\n{time}\n{channels}')
    return path


@pytest.mark.parametrize(
    "times",
    [
        pa.array([START_US * 1000 + 789], pa.timestamp("ns", tz="UTC")),
        pa.array([START_US], pa.timestamp("us", tz="Europe/Berlin")),
        pa.array([START_US // 1000], pa.timestamp("ms", tz="+01:00")),
        pa.array([START_US // 10**6], pa.timestamp("s", tz="UTC")),
        pa.array([START]),
    ],
)
def test_a_time_stamp_is_a_time_in_every_unit(tmp_path: Path, run: Run, times: pa.Array) -> None:
    status, report, _ = run("import", parquet(tmp_path, times))
    assert (status, report["stored"]) == (0, 5)
    assert {row[1] for row in stored(tmp_path)} == {START_US}


@pytest.mark.parametrize(
    ("times", "complaint"),
    [
        (pa.array([START_US // 10**6], pa.int64()), UTC_STAMPS),
        (pa.array([START_US // 1000], pa.int64()), UTC_STAMPS),
        (pa.array([START_US], pa.int64()), UTC_STAMPS),
        (pa.array([START_US * 1000], pa.int64()), UTC_STAMPS),
        (pa.array([START_US / 1e6], pa.float64()), UTC_STAMPS),
        (pa.array([True]), UTC_STAMPS),
        (pa.array([datetime(2026, 3, 1, tzinfo=UTC).date()]), UTC_STAMPS),
        (pa.array([START_US], pa.timestamp("us")), "expected an offset"),
        (pa.array([START_US * 1000 + 1], pa.timestamp("ns")), "expected an offset"),
        (pa.array([None], pa.timestamp("us", tz="UTC")), "time is empty; expected a time"),
        (pa.array([2**52], pa.timestamp("s", tz="UTC")), "expected a time from 1990 to tomorrow"),
        (pa.array([START_US * 1000], pa.timestamp("us", tz="UTC")), "from 1990 to tomorrow"),
        (pa.array([START_US // 10**6], pa.timestamp("us", tz="UTC")), "from 1990 to tomorrow"),
    ],
)
def test_what_does_not_say_that_it_is_a_time_is_none(
    tmp_path: Path, run: Run, times: pa.Array, complaint: str
) -> None:
    status, report, text = run("import", parquet(tmp_path, times))
    assert (status, report["stored"], report["rejected"]) == (2, 0, 1)
    assert "run.parquet: line 2: time" in text
    assert complaint in text
    assert stored(tmp_path) == []


def test_a_date_that_is_refused_is_shown_as_one(tmp_path: Path, run: Run) -> None:
    day = datetime(2026, 3, 1, tzinfo=UTC).date()
    text = run("import", parquet(tmp_path, pa.array([day])))[2]
    assert "run.parquet: line 2: time = 2026-03-01: expected a time stamp with a time zone" in text


@pytest.mark.parametrize(("unit", "per_s"), [("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_the_mapping_says_what_numbers_count(
    tmp_path: Path, run: Run, unit: str, per_s: int, suffix: str
) -> None:
    count = START_US // 10**6 * per_s
    path = parquet(tmp_path, pa.array([count], pa.int64()))
    if suffix == "csv":
        path = table(tmp_path, f"{count},1500,2650,21,40,38")
    plan = mapping(tmp_path, f'unit = "{unit}"')
    assert "expected --start with the time of 0 " in run("import", path, "--mapping", plan)[2]
    epoch = ("--start", "1970-01-01T00:00:00Z")
    assert run("import", path, "--mapping", plan, *epoch)[0] == 0
    assert {row[1] for row in stored(tmp_path)} == {START_US}


@pytest.mark.parametrize(
    ("time", "complaint"),
    [
        ('unit = "min"', "time.unit"),
        ('seconds = true\nunit = "ms"', "expected no unit beside seconds = true"),
    ],
)
def test_a_unit_that_cannot_be_used_is_named(
    tmp_path: Path, run: Run, time: str, complaint: str
) -> None:
    text = run("import", table(tmp_path, "0"), "--mapping", mapping(tmp_path, time))[2]
    assert complaint in text


def test_times_before_1990_and_after_tomorrow_are_refused_by_row(tmp_path: Path, run: Run) -> None:
    now_us = ProcessClock().now_us()
    soon, late = rfc3339(now_us + 20 * 3_600_000_000), rfc3339(now_us + 30 * 3_600_000_000)
    times = ["1970-01-21T10:03:50Z", "1989-12-31T23:59:59Z", "1990-01-01T00:00:00Z", soon, late]
    path = table(
        tmp_path, *(f"{time},1500,2650,21,40,38" for time in [*times, "9999-12-31T00:00Z"])
    )
    status, report, text = run("import", path)
    assert (status, report["stored"], report["rejected"]) == (2, 10, 4)
    assert [one["line"] for one in report["errors"]] == [2, 3, 6, 7]
    assert "line 2: time: 1970-01-21T10:03:50.000Z: expected a time from 1990 to tomorrow" in text
    assert {row[1] for row in stored(tmp_path)} == {from_rfc3339(times[2]), from_rfc3339(soon)}


def test_tomorrow_is_that_of_the_service(tmp_path: Path, run: Run) -> None:
    """A service with a fast clock exports times of next month, and takes them back."""
    ahead_us = ProcessClock().now_us() + 30 * 86_400_000_000
    path = table(tmp_path, f"{rfc3339(ahead_us)},1500,2650,21,40,38")
    assert run("import", path)[0] == 2
    anchor = {"rate": 60.0, "wall_s": ProcessClock().now_us() / 1e6, "process_us": ahead_us}
    (tmp_path / "data" / "clock.json").write_text(json.dumps(anchor))
    assert run("import", path)[0] == 0


def damaged(tmp_path: Path) -> Path:
    """A Parquet file of some row groups, of which a later one is damaged."""
    count = 50_000
    times = pa.array([START_US + k * 1000 for k in range(count)], pa.timestamp("us", tz="UTC"))
    rows: dict[str, Any] = {
        name: [one[0] + k * 1e-6 for k in range(count)] for name, one in VALUES.items()
    }
    path = tmp_path / "damaged.parquet"
    pq.write_table(pa.table({"time": times, **rows}), path, row_group_size=10_000)
    content = bytearray(path.read_bytes())
    place = len(content) * 2 // 3
    content[place : place + 2000] = bytes(one ^ 0xA5 for one in content[place : place + 2000])
    path.write_bytes(content)
    return path


def test_of_a_damaged_file_nothing_is_stored(tmp_path: Path, run: Run) -> None:
    text = run("import", damaged(tmp_path))[2]
    assert "damaged.parquet: damaged Parquet file, after row" in text
    assert stored(tmp_path) == []


def test_an_odd_column_beside_the_others_costs_nothing(tmp_path: Path, run: Run) -> None:
    stamps = pa.array([START_US], pa.timestamp("us", tz="UTC"))
    odd = {
        "day": pa.array([2**31 - 1], pa.int32()).view(pa.date32()),
        "clock": pa.array([2**40], pa.int64()).view(pa.time64("us")),
        "span": pa.array([2**62], pa.int64()).view(pa.duration("s")),
        "moment": pa.array([2**62], pa.int64()).view(pa.timestamp("us")),
    }
    path = tmp_path / "odd.parquet"
    pq.write_table(pa.table({"time": stamps, **VALUES, **odd}), path)
    plan = mapping(tmp_path, "")
    status, report, _ = run("import", path, "--mapping", plan)
    assert (status, report["stored"]) == (0, len(VALUES))


def test_a_column_whose_name_is_no_text_is_damage(tmp_path: Path, run: Run) -> None:
    path = parquet(tmp_path, pa.array([START]))
    path.write_bytes(path.read_bytes().replace(b"load_n", b"load\xff\xfe"))
    text = run("import", path)[2]
    assert "run.parquet: damaged Parquet file (the name of a column is not UTF-8)" in text


def test_a_time_is_no_count_and_no_value(tmp_path: Path, run: Run) -> None:
    stamps = pa.array([START_US], pa.timestamp("us", tz="UTC"))
    plan = mapping(tmp_path, 'unit = "ns"')
    status, report, _ = run(
        "import", parquet(tmp_path, stamps), "--mapping", plan, "--start", START
    )
    assert (status, report["stored"]) == (2, 0)
    path = tmp_path / "value.parquet"
    pq.write_table(pa.table({"time": stamps, "channel": ["load_n"], "value": stamps}), path)
    status, report, _ = run("import", path)
    assert (status, report["stored"], report["rejected"]) == (2, 0, 1)
