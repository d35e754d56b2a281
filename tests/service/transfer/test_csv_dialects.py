"""CSV as loggers and spreadsheets write it: nothing is misread, and no row is lost in silence."""

import random
from pathlib import Path

import pytest

from .conftest import Run, stored

HEADER = "time,speed_rpm,load_n,ambient_c,t_inner_ring_c,t_outer_ring_c,comment"
CHANNELS = HEADER.split(",")[1:-1]
ROWS = 60
GERMAN = "time;speed_rpm;load_n;ambient_c;t_inner_ring_c;t_outer_ring_c"


def mapping(tmp_path: Path, more: str = "") -> Path:
    path = tmp_path / "m.toml"
    channels = "".join(f'[channels.{name}]\ncolumn = "{name}"\n' for name in CHANNELS)
    path.write_text(f'{more}\n[time]\ncolumn = "time"\n{channels}')
    return path


def row(k: int, comment: str = "") -> str:
    return f"2026-03-01T12:{k:02d}:00Z,1500,2650,21,{40 + k},38,{comment}"


def commented(tmp_path: Path, comments: dict[int, str]) -> Path:
    path = tmp_path / "run.csv"
    rows = [row(k, comments.get(k, "")) for k in range(ROWS)]
    path.write_text("\n".join([HEADER, *rows]) + "\n")
    return path


def ring(tmp_path: Path) -> set[float | None]:
    return {value for name, _, value, _ in stored(tmp_path) if name == "t_inner_ring_c"}


@pytest.mark.parametrize(
    ("comments", "lost"),
    [
        ({10: '"new grease'}, [10]),
        ({10: '"new grease', 40: 'end of run"'}, [10]),
        ({10: '"new grease', 40: '"end of run'}, [10, 40]),
        ({59: '"stopped'}, [59]),
        ({10: 'flange 3/4"', 40: 'flange 3/4"'}, []),
        ({10: '"grease, 20 g"', 11: '"so called ""grease"""'}, []),
        ({10: '"two\nlines"'}, [10]),
        ({10: '"one" and two'}, [10]),
    ],
)
def test_a_quotation_mark_costs_its_own_line_only(
    tmp_path: Path, run: Run, comments: dict[int, str], lost: list[int]
) -> None:
    path = commented(tmp_path, comments)
    status, report, text = run("import", path, "--mapping", mapping(tmp_path))
    assert ring(tmp_path) == {40.0 + k for k in range(ROWS) if k not in lost}
    assert status == (2 if lost else 0)
    assert [one["line"] for one in report["errors"]][: len(lost)] == [k + 2 for k in lost]
    if lost and '" and' not in comments[10 if 10 in comments else 59]:
        assert f"line {lost[0] + 2}: a quotation mark that is not closed in its line" in text


@pytest.mark.parametrize(
    ("heading", "complaint"),
    [
        (
            '"com\nment"',
            "no header line: a quotation mark that is not closed in its line; expected it",
        ),
        ('"com\r\nment"', "no header line: a quotation mark that is not closed in its line; exp"),
        ('"comment', "no header line: a quotation mark that is not closed in its line; expected"),
        ('"com\rment"', "column 'com\\rment': a line end in its name; expected a name in one line"),
        ('"com" ment', "no header line: not CSV ("),
    ],
)
@pytest.mark.parametrize("empty_lines", [0, 2])
def test_a_name_of_a_column_stands_in_one_line(
    tmp_path: Path, run: Run, heading: str, complaint: str, empty_lines: int
) -> None:
    path = commented(tmp_path, {})
    text = "\n" * empty_lines + path.read_text().replace("comment", heading, 1)
    path.write_bytes(text.encode())
    said = run("import", path, "--mapping", mapping(tmp_path))[2]
    assert f"run.csv: line {empty_lines + 1}: {complaint}" in said
    assert said.count("expected") == 1
    assert stored(tmp_path) == []


def test_no_row_is_lost_in_silence_whatever_the_marks(tmp_path: Path, run: Run) -> None:
    dice = random.Random(7)
    for _ in range(8):
        alphabet = [*'"",ab\r ', "\u00e9"]
        comments = {k: "".join(dice.choices(alphabet, k=4)) for k in range(0, ROWS, 3)}
        path = commented(tmp_path, comments)
        report = run("import", path, "--mapping", mapping(tmp_path), "--dry-run")[1]
        lines = {one["line"] for one in report["errors"]}
        assert report["rows"] == ROWS
        assert report["samples"] == (ROWS - len(lines)) * len(CHANNELS)
        assert lines <= {k + 2 for k in comments}


@pytest.mark.parametrize("number", ["4_0", "４０", "٤٠", "0x28", "1e", "--4", "4 0", "1,5", "inf"])
def test_only_digits_are_numbers(tmp_path: Path, run: Run, number: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text(f'{HEADER}\n2026-03-01T12:00:00Z,1500,2650,21,"{number}",38,\n')
    status, _, text = run("import", path, "--mapping", mapping(tmp_path))
    assert status == 2
    assert "line 2: t_inner_ring_c = " in text
    assert ring(tmp_path) == set()


@pytest.mark.parametrize("number", ["40", "+40.", "4e1", " 40.0 ", "400E-1"])
def test_numbers_are_read_in_every_form(tmp_path: Path, run: Run, number: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text(f"{HEADER}\n2026-03-01T12:00:00Z,1500,2650,21,{number},38,\n")
    assert run("import", path, "--mapping", mapping(tmp_path))[0] == 0
    assert ring(tmp_path) == {40.0}


def german(tmp_path: Path, *rings: str) -> Path:
    path = tmp_path / "run.csv"
    rows = [f"2026-03-01T12:{k:02d}:00Z;1500;2650;21;{ring};38" for k, ring in enumerate(rings)]
    path.write_text("\n".join([GERMAN, *rows]) + "\n")
    return path


@pytest.mark.parametrize("number", [",5", "-0,5", "1.041,5", "4,15E1", " 41,5 "])
def test_a_decimal_comma_is_known_in_all_its_forms(tmp_path: Path, run: Run, number: str) -> None:
    path = german(tmp_path, "40", number)
    points = mapping(tmp_path, 'delimiter = ";"')
    assert "a decimal comma; expected a " in run("import", path, "--mapping", points)[2]
    assert stored(tmp_path) == []


def test_of_a_file_with_decimal_commas_no_part_is_stored_unasked(tmp_path: Path, run: Run) -> None:
    path = german(tmp_path, "40", "41", "41,5")
    points = mapping(tmp_path, 'delimiter = ";"')
    for options in (("--dry-run",), ()):
        text = run("import", path, "--mapping", points, *options)[2]
        assert "run.csv: line 4: t_inner_ring_c = '41,5': a decimal comma; expected a " in text
        assert stored(tmp_path) == []
    commas = mapping(tmp_path, 'delimiter = ";"\ndecimal = ","')
    assert run("import", path, "--mapping", commas)[0] == 0
    assert ring(tmp_path) == {40.0, 41.0, 41.5}


def test_counted_times_with_a_decimal_comma_are_known_too(tmp_path: Path, run: Run) -> None:
    """Else every second row would be stored: those of whole seconds."""
    path = tmp_path / "run.csv"
    rows = [f"{k // 2}{',5' if k % 2 else ''};1500;2650;21;40;38" for k in range(6)]
    path.write_text("\n".join([GERMAN, *rows]) + "\n")
    start = ("--start", "2026-03-01T12:00:00Z")
    counted = mapping(tmp_path, 'delimiter = ";"').with_name("counted.toml")
    points = mapping(tmp_path, 'delimiter = ";"').read_text()
    counted.write_text(points.replace("[time]\n", '[time]\nunit = "s"\n'))
    text = run("import", path, "--mapping", counted, *start)[2]
    assert "= '0,5': a decimal comma; expected a mapping with decimal" in text
    assert stored(tmp_path) == []
    counted.write_text('decimal = ","\n' + counted.read_text())
    assert run("import", path, "--mapping", counted, *start)[0] == 0
    assert len(stored(tmp_path)) == 6 * 5


def test_of_one_sample_in_a_row_no_mapping_is_asked_for(tmp_path: Path, run: Run) -> None:
    path = tmp_path / "run.csv"
    path.write_text('time,channel,value\n2026-03-01T12:00:00Z,t_inner_ring_c,"41,5"\n')
    text = run("import", path)[2]
    assert "value = '41,5': a decimal comma; expected a decimal point" in text
    assert stored(tmp_path) == []


@pytest.mark.parametrize("number", ["1.041,5", "1.041", "41,5,0"])
def test_separators_of_thousands_are_no_part_of_a_number(
    tmp_path: Path, run: Run, number: str
) -> None:
    path = german(tmp_path, number)
    commas = mapping(tmp_path, 'delimiter = ";"\ndecimal = ","')
    status, _, text = run("import", path, "--mapping", commas)
    assert (status, ring(tmp_path)) == (2, set())
    assert f"t_inner_ring_c = {number!r}: expected a number" in text


@pytest.mark.parametrize(
    ("encoding", "complaint"),
    [
        ("utf-16", "in UTF-16; expected CSV in UTF-8"),
        ("latin-1", "line 42: not CSV in UTF-8 (byte"),
    ],
)
def test_another_encoding_is_named_and_nothing_is_stored(
    tmp_path: Path, run: Run, encoding: str, complaint: str
) -> None:
    path = commented(tmp_path, {40: "für später"})
    path.write_bytes(path.read_text().encode(encoding))
    text = run("import", path, "--mapping", mapping(tmp_path))[2]
    assert complaint in text
    assert stored(tmp_path) == []


def test_a_message_is_not_as_long_as_the_cell(tmp_path: Path, run: Run) -> None:
    path = commented(tmp_path, {})
    content = path.read_text().replace("2026-03-01T12:20", "\0" * 4096 + "2026-03-01T12:20")
    path.write_text(
        content.replace("2026-03-01T12:30:00Z,1500", "2026-03-01T12:30:00Z," + "x" * 9000)
    )
    status, report, text = run("import", path, "--mapping", mapping(tmp_path))
    assert (status, report["rejected"]) == (2, 2)
    assert max(map(len, text.splitlines())) < 500
