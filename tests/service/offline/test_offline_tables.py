from pathlib import Path

import numpy as np
import pytest

from service.files import replacing
from service.offline.tables import (
    TableError,
    check_writable,
    read_profile,
    read_recording,
    write_forecast,
)

HEADER = "time_s,speed_rpm,load_n,ambient_c,t_inner_ring_c,t_outer_ring_c"
ROW = "0,1500,2650,22.0,30.0,25.0"


def recording(folder: Path, *lines: str) -> Path:
    path = folder / "data.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ([], "line 1: empty file; expected a header"),
        ([HEADER], "line 2: no rows; expected at least one"),
        ([HEADER.replace(",load_n", "")], "line 1: missing column 'load_n'; expected time_s, sp"),
        ([HEADER.replace("time_s,", "")], "line 1: missing column time or time_s; expected one"),
        ([f"time,{HEADER}"], "line 1: both time and time_s; expected one"),
        ([f"{HEADER},t_node_14_c"], "line 1: unknown column 't_node_14_c'; expected time_s, sp"),
        ([f"{HEADER},load_n"], "line 1: column 'load_n' occurs twice; expected once"),
        ([HEADER, ROW, "60,15oo,2650,22,30,25"], "line 3: speed_rpm = '15oo': expected a number o"),
        ([HEADER, ROW, "60,1500,nan,22,30,25"], "line 3: load_n = 'nan': expected a number or an"),
        ([HEADER, "0,1500,2650,22,9999,25"], "line 2: t_inner_ring_c = 9999: expected -60 to 400"),
        ([HEADER, ",1500,2650,22,30,25"], "line 2: time_s = '': expected a number"),
        ([HEADER, ROW, "", ROW], "line 4: time_s = 0: expected a time after that of line 2"),
        ([HEADER, "0,1500,2650"], "line 2: 3 cells; expected 6"),
        (
            [HEADER.replace("time_s", "time"), ROW.replace("0,", "2026-11-21 08:00,", 1)],
            "line 2: time '2026-11-21 08:00': expected an offset",
        ),
        (
            [HEADER.replace("time_s", "time"), ROW.replace("0,", "8 o'clock,", 1)],
            'line 2: time "8 o\'clock": expected RFC 3339 such as',
        ),
    ],
)
def test_unusable_data_are_refused_with_place_and_expectation(
    tmp_path: Path, lines: list[str], expected: str
) -> None:
    with pytest.raises(TableError) as refusal:
        read_recording(recording(tmp_path, *lines))
    assert str(refusal.value).startswith(f"data.csv: {expected}")


def test_unreadable_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TableError, match=r"none\.csv: cannot be read \(No such file"):
        read_recording(tmp_path / "none.csv")
    with pytest.raises(TableError, match="cannot be read"):
        read_recording(tmp_path)
    binary = tmp_path / "binary.csv"
    binary.write_bytes(b"\xff\xfe\x00time_s")
    with pytest.raises(TableError, match="not UTF-8 text; expected a CSV file"):
        read_recording(binary)


def test_dates_columns_in_any_order_byte_order_mark_and_empty_cells(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text(
        "\ufefft_node_7_c,time, ambient_c ,t_outer_ring_c,load_n,speed_rpm,t_inner_ring_c\r\n"
        "41.5,2026-11-21T08:00:00.000Z,22.5,25,2650,1500,\r\n"
        "\r\n"
        ",2026-11-21T09:01:00.5+01:00,,26,,1501, 31 \r\n",
        encoding="utf-8",
    )
    found = read_recording(path)
    assert found.start_us == 1_795_248_000_000_000
    np.testing.assert_array_equal(found.time_s, [0.0, 60.5])
    np.testing.assert_array_equal(found.speed_rpm, [1500.0, 1501.0])
    np.testing.assert_array_equal(found.load_n, [2650.0, np.nan])
    np.testing.assert_array_equal(found.ambient_c, [22.5, np.nan])
    assert set(found.temperatures_c) == {"t_inner_ring_c", "t_outer_ring_c", "t_node_7_c"}
    np.testing.assert_array_equal(found.temperatures_c["t_inner_ring_c"], [np.nan, 31.0])
    np.testing.assert_array_equal(found.temperatures_c["t_node_7_c"], [41.5, np.nan])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("time_s,speed_rpm,load_n\n0,1,2\n", "line 1: missing column 'ambient_c'; expected time_s"),
        ("time,speed_rpm,load_n,ambient_c\n", "line 1: missing column 'time_s'"),
        (f"{HEADER}\n{ROW}\n", "line 1: unknown column 't_inner_ring_c'; expected time_s, speed"),
        ("time_s,speed_rpm,load_n,ambient_c\n0,1,,3\n", "line 2: load_n = '': expected a number"),
        ("time_s,speed_rpm,load_n,ambient_c\n-60,1,2,3\n", "line 2: time_s = -60: expected 0 or m"),
    ],
)
def test_unusable_profiles_are_refused(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "profile.csv"
    path.write_text(text)
    with pytest.raises(TableError) as refusal:
        read_profile(path)
    assert str(refusal.value).startswith(f"profile.csv: {expected}")


def test_the_five_quantiles_of_a_name_stand_side_by_side(tmp_path: Path) -> None:
    path = tmp_path / "forecast.csv"
    quantiles = np.arange(20.0).reshape(5, 2, 2)
    edges = {"b": np.array([[-1.0, 3.0], [18.0, 20.0]])}
    write_forecast(path, np.array([0.0, 1234567.5]), ["a", "b"], quantiles, edges)
    lines = path.read_text().splitlines()
    names = "time_s,a_q025,a_q25,a_q50,a_q75,a_q975,b_q025,b_q25,b_q50,b_q75,b_q975"
    assert lines[0] == f"{names},b_whole_low,b_whole_high"
    figures = [0, 0, 4, 8, 12, 16, 1, 5, 9, 13, 17, -1, 18]
    assert [float(cell) for cell in lines[1].split(",")] == figures
    assert float(lines[2].split(",")[0]) == 1234567.5
    assert [each.name for each in tmp_path.iterdir()] == ["forecast.csv"]


def test_what_is_not_complete_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_text("old")

    def stop_half_way() -> None:
        with replacing(path) as file:
            file.write("ne")
            raise SystemExit

    with pytest.raises(SystemExit):
        stop_half_way()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_places_that_take_no_file_are_refused_beforehand(tmp_path: Path) -> None:
    check_writable(tmp_path / "new.json")
    with pytest.raises(TableError, match="expected a file in an existing folder"):
        check_writable(tmp_path / "none" / "new.json")
    with pytest.raises(TableError, match="expected a file in an existing folder"):
        check_writable(tmp_path)
