"""Alarm settings: every alarm has a row, sheets come back as they went, a mistake stops all."""

import csv
import io
import json
import re
from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.alarm_kinds import KINDS
from service.domain.alarm_guidance import AlarmName
from service.domain.texts import is_one_line
from service.features.alarm_settings.settings_changes import (
    JudgedSettings,
    WantedRow,
    judge_settings,
)
from service.features.alarm_settings.sheets import (
    COLUMNS,
    AlarmSheetError,
    as_csv,
    cells_of,
    read_csv,
    read_json,
)
from service.site.alarm_overlay import FIELDS, TEXTS, AlarmedAsset, in_effect, rows_of
from service.site.asset_section import AssetSection
from service.site.check_limits import CheckLimits
from service.site.wiring import ChannelFacts

NAMES = ("speed_rpm", "load_n", "ambient_c", "t_inner_ring_c", "t_outer_ring_c")
SECTION = AssetSection.model_validate(
    {
        "id": "bench-1",
        "bearing": "6311",
        "low_risk": {"speed_rpm_max": 4300, "load_n_max": 3400},
        "limits": {
            "t_inner_ring_c": {"warning": 70, "alarm": 95},
            "t_node_5_c": {"warning": 80, "alarm": 100},
        },
        "channels": {name: {"source": "push"} for name in NAMES},
        "alarms": {"above_ambient": {"limits": {"t_inner_ring_c": {"warning": 50, "alarm": 65}}}},
    }
)
FACTS = {name: ChannelFacts("push", 10.0, CheckLimits(-80.0, 150.0)) for name in NAMES}
ASSET = AlarmedAsset(SECTION, FACTS)
ASSETS = {"bench-1": ASSET}
WARNING = ("measured limit", "t_inner_ring_c", "warning")
ALARM = ("measured limit", "t_inner_ring_c", "alarm")
NUMBER = re.compile(r"[+-]?[0-9.]+(e[+-]?[0-9]+)?", re.IGNORECASE)
Overlay = dict[AlarmName, dict[str, Any]]


def judge(
    overlay: Mapping[AlarmName, Mapping[str, Any]], *rows: tuple[AlarmName, Mapping[str, Any]]
) -> JudgedSettings:
    wanted = [WantedRow(place, "bench-1", *row) for place, row in enumerate(rows, 1)]
    return judge_settings(ASSETS, {"bench-1": overlay}, wanted)


def after(overlay: Overlay, judged: JudgedSettings) -> Overlay:
    return overlay | {name: one for (_, name), one in judged.changes.items()}


def sheet(overlay: Overlay) -> str:
    return as_csv(cells_of(row) for row in rows_of(ASSET, overlay))


def test_every_kind_has_rows_and_texts_that_say_what_to_do() -> None:
    rows = rows_of(ASSET, {})
    assert {row.name[0] for row in rows} == set(KINDS)
    assert len({row.name for row in rows}) == len(rows)
    for row in rows:
        said = [row.values[key] for key in ("probable_causes", "consequence_of_inaction")]
        assert all(said), row
        assert row.values["operator_action"]
        # What the product says is what an engineer may say.
        assert not judge({}, (row.name, dict(row.values))).mistakes, row
    assert ("forecast limit", "t_node_5_c", "alarm") in {row.name for row in rows}
    assert ("measured limit", "t_node_5_c", "alarm") not in {row.name for row in rows}


texts = st.text(st.characters(blacklist_categories=("Cs", "Cc", "Zl", "Zp")), max_size=30).filter(
    lambda text: is_one_line(text) and not text.strip().startswith("'")
)
fields = st.fixed_dictionaries(
    {},
    optional={
        "on_delay_s": st.floats(0, 86_400),
        "off_delay_s": st.floats(0, 86_400),
        "priority": st.sampled_from([1, 2, 3]),
        "latched": st.booleans(),
        "enabled": st.booleans(),
        "re_alarm_s": st.floats(0, 86_400),
        "remarks": texts,
        "probable_causes": texts,
        "severity_of_consequence": texts,
        "allowable_response_time_s": st.floats(1, 86_400),
    },
)
names = st.sampled_from([row.name for row in rows_of(ASSET, {})])
wanted = st.dictionaries(names, fields, max_size=8)
setpoints = st.tuples(st.floats(30, 79), st.floats(80, 150))


@settings(max_examples=60, deadline=None)
@given(wanted, setpoints)
def test_what_was_exported_changes_nothing_when_imported(
    edits: dict[AlarmName, dict[str, Any]], pair: tuple[float, float]
) -> None:
    edits[WARNING] = edits.get(WARNING, {}) | {"setpoint": pair[0]}
    edits[ALARM] = edits.get(ALARM, {}) | {"setpoint": pair[1]}
    judged = judge({}, *edits.items())
    assert judged.mistakes == []
    overlay = after({}, judged)
    text = sheet(overlay)
    rows, mistakes = read_csv(text.encode())
    again = judge_settings(ASSETS, {"bench-1": overlay}, rows)
    assert (mistakes, again.mistakes, again.differences, again.changes) == ([], [], [], {})
    # Into a service that knows nothing of it the sheet brings all of it.
    fresh = judge_settings(ASSETS, {}, rows)
    assert sheet(after({}, fresh)) == text
    # And as JSON.
    document = {"rows": [cells_of(row) for row in rows_of(ASSET, overlay)]}
    rows, mistakes, _ = read_json(json.dumps(document).encode())
    again = judge_settings(ASSETS, {"bench-1": overlay}, rows)
    assert (mistakes, again.mistakes, again.changes) == ([], [], {})
    # No cell is a formula in a spreadsheet.
    for cells in csv.reader(io.StringIO(text.removeprefix("\ufeff"))):
        for cell in cells:
            assert cell[:1] not in ("=", "+", "-", "@") or NUMBER.fullmatch(cell)


def test_a_text_that_was_kept_before_its_kind_was_refused_changes_nothing() -> None:
    overlay = {WARNING: {"remarks": "left\u200eto right"}}
    rows, mistakes = read_csv(sheet(overlay).encode())
    again = judge_settings(ASSETS, {"bench-1": overlay}, rows)
    assert (mistakes, again.mistakes, again.changes) == ([], [], {})


MISTAKES: list[tuple[AlarmName, dict[str, Any], str, str]] = [
    (WARNING, {"setpoint": 95}, "setpoint", "warning 95 must be below alarm 95"),
    (ALARM, {"setpoint": 60}, "setpoint", "warning 70 must be below alarm 60"),
    (ALARM, {"setpoint": 160}, "setpoint", "outside of what the sensor can measure"),
    (ALARM, {"setpoint": 1e9}, "setpoint", "less than or equal to 500"),
    (ALARM, {"setpoint": "hot"}, "setpoint", "expected a number"),
    (ALARM, {"setpoint": float("nan")}, "setpoint", "finite"),
    (ALARM, {"priority": 4}, "priority", "1 (high), 2 (medium) or 3 (low)"),
    (ALARM, {"priority": 1.5}, "priority", "1 (high), 2 (medium) or 3 (low)"),
    (ALARM, {"on_delay_s": -1}, "on_delay_s", "greater than or equal to 0"),
    (ALARM, {"deadband": 51}, "deadband", "less than or equal to 50"),
    (ALARM, {"latched": "perhaps"}, "latched", "yes or no"),
    (ALARM, {"operator_action": "Watch."}, "operator_action", "no action"),
    (ALARM, {"remarks": "two\nlines"}, "remarks", "one line"),
    (ALARM, {"remarks": "'=1"}, "remarks", "apostrophe"),
    (ALARM, {"status": "approved"}, "rationalised_by", "who approved it"),
    (ALARM, {"status": "good"}, "status", "default, proposed, approved"),
    (ALARM, {"rationalised_at": "yesterday"}, "rationalised_at", "date"),
    (("sensor fault", "load_n", ""), {"setpoint": 5}, "setpoint", "no setpoint"),
    (("sensor fault", "load_n", ""), {"deadband": 5}, "deadband", "no deadband"),
    (("measured limit", "t_shaft_c", "alarm"), {}, "tag", "'t_shaft_c' has no alarm"),
    (("measured limit", "t_inner_ring_c", ""), {}, "level", "expected warning, alarm"),
    (("limit", "t_inner_ring_c", "alarm"), {}, "kind", "expected one of above ambient"),
]


@pytest.mark.parametrize(("name", "change", "column", "said"), MISTAKES)
def test_one_mistake_refuses_every_row(
    name: AlarmName, change: dict[str, Any], column: str, said: str
) -> None:
    good = (("rate of rise", "t_inner_ring_c", "warning"), {"setpoint": 3.0})
    judged = judge({}, good, (name, change))
    assert [one.column for one in judged.mistakes][:1] == [column]
    assert said in judged.mistakes[0].text
    assert judged.mistakes[0].place == 2
    assert judged.changes == {}


def test_a_forecast_has_the_limit_of_the_measurement() -> None:
    forecast = ("forecast limit", "t_inner_ring_c", "warning")
    overlay = after({}, judge({}, (forecast, {"setpoint": 65})))
    assert overlay == {WARNING: {"setpoint": 65.0}}
    assert in_effect(ASSET, overlay).section.limits["t_inner_ring_c"].warning == 65
    shown = {row.name: row for row in rows_of(ASSET, overlay)}
    assert shown[forecast].values["setpoint"] == shown[WARNING].values["setpoint"] == 65
    both = judge({}, (forecast, {"setpoint": 65}), (WARNING, {"setpoint": 66}))
    assert "one limit" in both.mistakes[0].text
    node = ("forecast limit", "t_node_5_c", "alarm")
    overlay = after({}, judge({}, (node, {"setpoint": 99})))
    assert in_effect(ASSET, overlay).section.limits["t_node_5_c"].alarm == 99
    # Undone as the history names it.
    back = judge(overlay, (("measured limit", *node[1:]), {"setpoint": None}))
    assert (back.mistakes, after(overlay, back)[("measured limit", *node[1:])]) == ([], {})
    assert in_effect(ASSET, overlay).problems == {}


def test_what_no_longer_fits_the_configuration_is_not_in_effect() -> None:
    overlay = {WARNING: {"setpoint": 99.0, "priority": 3}, ("gone", "x", ""): {"priority": 1}}
    effective = in_effect(ASSET, overlay)
    assert effective.section.limits == SECTION.limits
    assert set(effective.problems) == set(overlay)


def test_back_to_the_configuration() -> None:
    overlay = after({}, judge({}, (ALARM, {"setpoint": 90, "remarks": "lower"})))
    assert overlay == {ALARM: {"setpoint": 90.0, "remarks": "lower"}}
    back = judge(overlay, (ALARM, {"setpoint": None}))
    assert after(overlay, back) == {ALARM: {"remarks": "lower"}}
    both = {(one.name, one.before, one.after) for one in back.differences}
    assert both == {(ALARM, 90, 95), (("forecast limit", *ALARM[1:]), 90, 95)}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("asset,tag,kind\n", "missing column level"),
        ("asset,tag,kind,level,set\n", "unknown column 'set'"),
        ("asset,tag,kind,level,level\n", "twice"),
        ("", "empty"),
        ("asset,tag,kind,level\n\xff".encode("latin-1").decode("latin-1"), ""),
    ],
)
def test_a_sheet_that_is_none(text: str, said: str) -> None:
    if not said:
        with pytest.raises(AlarmSheetError):
            read_csv(text.encode("latin-1"))
        return
    with pytest.raises(AlarmSheetError, match=said):
        read_csv(text.encode())


def test_mistakes_name_the_line_of_the_file_and_the_unit() -> None:
    text = (
        "asset;tag;kind;level;setpoint;unit\nbench-1;t_inner_ring_c;measured limit;alarm;200;°F\n"
    )
    rows, _ = read_csv(text.encode())
    (first, *_) = judge_settings(ASSETS, {}, rows).mistakes
    assert (first.place, first.column) == (2, "unit")
    rows, _ = read_csv(text.replace("bench-1", "bench-2").encode())
    (only,) = judge_settings(ASSETS, {}, rows).mistakes
    assert (only.column, only.text) == ("asset", "no asset 'bench-2'; did you mean 'bench-1'?")


def test_a_spreadsheet_of_a_country_with_decimal_commas_is_read() -> None:
    text = "asset;tag;kind;level;setpoint\nbench-1;t_inner_ring_c;measured limit;alarm;88,5\n"
    rows, _ = read_csv(text.encode())
    (change,) = judge_settings(ASSETS, {}, rows).changes.values()
    assert change == {"setpoint": 88.5}
    with_points, _ = read_csv(text.replace(";", ",").replace("88,5", '"88,5"').encode())
    assert "expected a number" in judge_settings(ASSETS, {}, with_points).mistakes[0].text


def test_columns_hold_all_that_can_be_set() -> None:
    assert set(FIELDS) <= set(COLUMNS)
    assert set(TEXTS) <= set(FIELDS)
