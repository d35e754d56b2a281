"""Lists of assets: every row is judged for itself, and what is written is read back."""

import json
from pathlib import Path

import pytest

from service.features.provisioning.lists import (
    AssetListError,
    AssetRows,
    as_csv,
    as_json,
    judge_list,
    read_csv,
    read_json,
)
from service.site.configuration import SettingsError
from service.site.settings import Settings, load_settings

SITE = """\
[[sources]]
name = "gateway-1"
driver = "modbus-tcp"
host = "127.0.0.1"
port = 5020

[[templates]]
name = "axle"
bearing = "6311"
low_risk = { speed_rpm_max = 900, load_n_max = 4000 }
values = { gateway = "gateway-1" }
[templates.channels]
t_outer_ring_c = { source = "{gateway}", unit_id = "{unit}", register = 0, kind = "input" }
ambient_c = { source = "push" }
speed_rpm = { source = "push" }
load_n = { source = "push" }

[[assets]]
id = "bench-1"
template = "axle"
values = { unit = 1 }
"""


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    file = tmp_path / "twin.toml"
    file.write_text(SITE)
    return load_settings(file)


def tables(rows: AssetRows) -> dict[str, object]:
    return {name: one.table for name, one in rows.assets.items()}


def lines(rows: AssetRows) -> list[tuple[int, str | None, str]]:
    return [(row.row, row.id, line) for row in rows.wrong for line in row.lines]


@pytest.mark.parametrize("separator", [",", ";"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_csv_comes_as_spreadsheets_write_it(separator: str, mark: bytes, end: str) -> None:
    text = end.join(
        separator.join(cells)
        for cells in (
            ["id", "template", "name", "bearing", "unit", "gain", "serial", "note"],
            ["axle-1", "axle", '"Größe 3, A; B"', "6311", "11", "-0.5", "007", ""],
            ["", "", "", "", "", "", "", ""],
            ["axle-2", "axle", "", "", "1e3", "nan", "1_000", "'=1+1"],
        )
    )
    found = read_csv(mark + text.encode())
    assert found.wrong == []
    assert tables(found) == {
        "axle-1": {
            "template": "axle",
            "name": "Größe 3, A; B",
            "bearing": "6311",
            "values": {"unit": 11, "gain": -0.5, "serial": "007"},
        },
        "axle-2": {
            "template": "axle",
            "values": {"unit": 1000.0, "gain": "nan", "serial": "1_000", "note": "=1+1"},
        },
    }
    assert type(found.assets["axle-1"].table["values"]["unit"]) is int
    assert [one.row for one in found.assets.values()] == [2, 4]


def test_bad_rows_of_csv_are_named_by_their_lines() -> None:
    found = read_csv(b"id,unit\na-1,1\n,2\na-2\na-1,3\na-3,4\n")
    assert tables(found) == {"a-3": {"values": {"unit": 4}}}
    assert sorted(lines(found)) == [
        (2, "a-1", "id = 'a-1': rows 2, 5 have it; expected unique"),
        (3, None, "id: missing; expected the id of an asset"),
        (4, None, "1 cells; expected 2"),
        (5, "a-1", "id = 'a-1': rows 2, 5 have it; expected unique"),
    ]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "line 1: empty file"),
        (b"name,unit\nx,1\n", "line 1: missing column 'id'"),
        (b"id,unit,unit\na,1,2\n", "line 1: column 'unit' occurs twice"),
        (b"id,,unit\na,1,2\n", "line 1: a column without a name"),
        (b"id,name\na,\xff\n", "not CSV in UTF-8"),
    ],
)
def test_csv_that_cannot_be_read_is_refused_as_a_whole(content: bytes, expected: str) -> None:
    with pytest.raises(AssetListError, match=expected.replace("'", ".")):
        read_csv(content)


def test_bad_entries_of_json_are_named_by_their_places() -> None:
    listed = [{"id": "a", "values": {"n": 1}}, {"id": 3}, 4, {"n": 1}, {"id": "b"}, {"id": "b"}]
    found = read_json(json.dumps({"assets": listed}).encode())
    assert tables(found) == {"a": {"values": {"n": 1}}}
    assert {(row, line.partition(":")[0]) for row, _, line in lines(found)} == {
        (2, "id = 3"),
        (3, "expected a table with an id"),
        (4, "id"),
        (5, "id = 'b'"),
        (6, "id = 'b'"),
    }


@pytest.mark.parametrize(
    "content",
    [b"", b"[]", b'{"assets": {}}', b'{"assets": [], "more": 1}', b"[" * 100_000, b"\xff\xfe\xfd"],
)
def test_json_that_is_no_list_is_refused_as_a_whole(content: bytes) -> None:
    with pytest.raises(AssetListError):
        read_json(content)


def test_a_list_is_compared_with_what_there_is(settings: Settings) -> None:
    csv = (
        "id,template,unit,gateway\n"
        "new,axle,1,\nother,axle,2,\nsame,axle,3,\n"
        "bench-1,axle,4,\nno hole,axle,5,\nlost,axle,,\nfar,axle,7,gateway-2\n"
    )
    present = {
        "same": {"template": "axle", "values": {"unit": 3}},
        "other": {"template": "axle", "values": {"unit": 9}},
        "not in the list": {},
    }
    judged = judge_list(settings, read_csv(csv.encode()), present)
    assert judged.created == {"new": {"template": "axle", "values": {"unit": 1}}}
    assert judged.changed == {"other": {"template": "axle", "values": {"unit": 2}}}
    assert judged.unchanged == 1
    assert judged.changes == judged.created | judged.changed
    wrong = {row.row: " ".join(row.lines) for row in judged.wrong}
    assert list(wrong) == [5, 6, 7, 8]
    assert wrong[5].startswith("stands in the configuration file")
    assert wrong[6].startswith("id = 'no hole': ")
    assert wrong[7] == "values.unit: missing; template 'axle' asks for it"
    assert wrong[8].startswith("channels.t_outer_ring_c.source = 'gateway-2': ")
    assert "gateway-1" in wrong[8]


@pytest.mark.parametrize(
    "table",
    [
        {"template": ["axle"], "values": {"unit": 1}},
        {"template": "axle", "values": {"unit": [1]}},
        {"template": "axle", "values": {"unit": 1}, "channels": {"load_n": {"source": ["push"]}}},
        {"template": "axle", "values": {"unit": 1}, "channels": {"load_n": {"source": {}}}},
        {"template": "axle", "values": {"unit": 1}, "name": "a\0b"},
        {"template": "axle", "values": {"unit": 1}, "name": "\ud800"},
        {"template": "axle", "values": {"unit": float("inf")}},
        {"template": "axle", "values": {"unit": 1}, "id": "another"},
        {"template": "axle", "values": {"unit": 1}, "channels": []},
        {"template": "axle", "values": {"unit": 1}, "bearing": {}},
        {"network": "no-such-file.toml"},
        {},
    ],
)
def test_whatever_a_table_holds_an_error_says_what_is_wrong(
    settings: Settings, table: dict[str, object]
) -> None:
    rows = read_json(json.dumps({"assets": [{"id": "right"} | {"template": "axle"}]}).encode())
    (one,) = rows.assets.values()
    one.table.clear()
    one.table.update(table)
    judged = judge_list(settings, rows, {})
    (wrong,) = judged.wrong
    assert judged.changes == {}
    assert all("expected" in line or ": " in line for line in wrong.lines), wrong.lines


def test_what_is_written_is_read_back() -> None:
    assets = {
        "axle-1": {"template": "axle", "name": "=SUM(A1)", "values": {"unit": 1, "gain": 0.25}},
        "axle-2": {
            "template": "axle",
            "group": 'Line "7"',
            "family": "7",
            "values": {"serial": "007"},
        },
        "axle-3": {"template": "axle"},
    }
    assert tables(read_csv(as_csv(assets).encode())) == assets
    assert as_csv(assets).splitlines()[0] == "id,template,name,group,family,gain,serial,unit"
    more = assets | {"bench": {"channels": {"load_n": {"source": "push"}}, "bearing": "6311"}}
    assert tables(read_json(as_json(more).encode())) == more
    with pytest.raises(SettingsError, match=r"bench\.channels: CSV cannot hold it"):
        as_csv(more)
    with pytest.raises(SettingsError, match=r"axle-4\.values: CSV cannot hold it"):
        as_csv({"axle-4": {"template": "axle", "values": {"serial": "7"}}})
    assert tables(read_csv(as_csv({}).encode())) == {}


def test_no_cell_of_a_list_is_run_by_a_spreadsheet() -> None:
    formula = "=cmd|' /C calc'!A0"
    assets = {"a": {"template": "axle", "name": formula, "values": {"unit": "@SUM(1)"}}}
    text = as_csv(assets)
    assert text.splitlines()[1] == f"a,axle,'{formula},'@SUM(1)"
    assert tables(read_csv(text.encode())) == assets


@pytest.mark.parametrize("key", ["name", "group", "family"])
@pytest.mark.parametrize("break_", ["\n", "\r", "\u2028", "\x1b", "\t", "\u202e", "\ufeff"])
def test_a_name_is_one_line(settings: Settings, key: str, break_: str) -> None:
    listed = {"id": "axle-1", "template": "axle", "values": {"unit": 11}, key: f"two{break_}lines"}
    judged = judge_list(settings, read_json(json.dumps({"assets": [listed]}).encode()), {})
    (row,) = judged.wrong
    assert row.lines == (
        f"{key} = {listed[key]!r}: expected one line of text, without control characters",
    )
    assert not judged.changes


def test_a_name_of_the_values_of_a_template_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / "site.toml"
    values = 'values = { hall = "A", gateway'
    file.write_text(SITE.replace("values = { gateway", f'group = "{{hall}}"\n{values}'))
    listed = {"id": "axle-1", "template": "axle", "values": {"unit": 1, "hall": "a\x1b"}}
    content = json.dumps({"assets": [listed]}).encode()
    judged = judge_list(load_settings(file), read_json(content), {})
    (row,) = judged.wrong
    expected = "expected one line of text, without control characters"
    assert row.lines == (f"group = 'a\\x1b': {expected}",)


@pytest.mark.parametrize("key", ["id", "name"])
def test_half_of_a_surrogate_pair_is_refused(key: str) -> None:
    with pytest.raises(AssetListError, match="not valid JSON"):
        read_json(json.dumps({"assets": [{"id": "axle-1", key: "\ud800"}]}).encode())


def test_json_may_be_in_any_encoding_of_unicode() -> None:
    text = json.dumps({"assets": [{"id": "axle-1", "name": "Prüfstand"}]}, ensure_ascii=False)
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        assert tables(read_json(text.encode(encoding))) == {"axle-1": {"name": "Prüfstand"}}
