"""Alarm settings over REST: sheets, dry runs, all or nothing, history, and the trail."""

import csv
import io
from typing import Any

import pytest

from service.alarms import AlarmCondition
from service.domain.errors import CellUnavailableError
from service.features.alarm_settings.sheets import COLUMNS
from service.features.ledger.tables import KeptForecasts
from service.site.settings import Settings
from service.store.forecast_records import IssuedContent, IssuedForecast

SETTINGS = "/api/v1/alarm-settings"
CSV = {"Content-Type": "text/csv; charset=utf-8"}
RING = {"asset": "bench-1", "tag": "t_inner_ring_c"}
WARNING = RING | {"kind": "measured limit", "level": "warning"}
ALARM = RING | {"kind": "measured limit", "level": "alarm"}
CONFIGURATION = {
    "assets": [
        {
            "id": name,
            "bearing": "6311",
            "low_risk": {"speed_rpm_max": 4300, "load_n_max": 3400},
            "limits": {"t_inner_ring_c": {"warning": 70, "alarm": 95}},
            "channels": {
                channel: {"source": "push"}
                for channel in ("speed_rpm", "load_n", "ambient_c", "t_inner_ring_c")
            },
        }
        for name in ("bench-1", "bench-2")
    ]
}


@pytest.fixture
def settings(world: Any) -> Any:
    """Give the application two assets, and count how often the cell takes changes up."""
    asked: list[int] = []

    async def apply() -> dict[str, str]:
        asked.append(1)
        return {}

    world.have(settings=Settings(**CONFIGURATION), apply_assets=apply)
    world.asked = asked
    return world


def row(answer: Any, **names: str) -> Any:
    (found,) = [one for one in answer["items"] if names.items() <= one.items()]
    return found


async def test_a_setpoint_is_changed_and_taken_up_at_once(settings: Any) -> None:
    engineer = settings.client("engineer")
    patch = WARNING | {"setpoint": 65.0, "class": "fire", "comment": "as the maker says"}
    tried = (await engineer.patch(SETTINGS, json=patch, params={"dry_run": True})).json()
    assert (tried["changed"], tried["dry_run"], tried["in_effect"]) == (1, True, False)
    assert not settings.asked
    done = await engineer.patch(SETTINGS, json=patch)
    assert done.status_code == 200, done.text
    document = done.json()
    assert document["differences"] == tried["differences"]
    assert (document["revision"], document["in_effect"], len(settings.asked)) == (1, True, 1)
    answer = (await engineer.get(SETTINGS, params={"asset": "bench-1"})).json()
    shown = row(answer, kind="measured limit", tag="t_inner_ring_c", level="warning")
    assert (shown["setpoint"], shown["class"], shown["changed"]) == (
        65,
        "fire",
        ["setpoint", "class"],
    )
    assert (
        row(answer, kind="forecast limit", level="warning", tag="t_inner_ring_c")["setpoint"] == 65
    )
    assert answer["revision"] == 1
    (line,) = [one for one in settings.store.audit.page(10).items if "alarm_s" in one.action]
    assert "as the maker says; bench-1 " in line.detail
    assert "setpoint: 70 -> 65" in line.detail
    (change,) = (await engineer.get(f"{SETTINGS}/history")).json()["items"]
    assert (change["before"], change["after"]) == ({}, {"setpoint": 65, "class": "fire"})
    assert change["comment"] == "as the maker says"
    # Undo: what it was before.
    undo = WARNING | {"setpoint": None, "class": None, "comment": "undo"}
    assert (await engineer.patch(SETTINGS, json=undo)).json()["changed"] == 1
    answer = (await engineer.get(SETTINGS, params={"asset": "bench-1"})).json()
    assert (
        row(answer, kind="measured limit", tag="t_inner_ring_c", level="warning")["changed"] == []
    )


async def test_a_sheet_comes_and_goes_as_csv(settings: Any) -> None:
    engineer = settings.client("engineer")
    sheet = await engineer.get(SETTINGS, params={"format": "csv"})
    assert sheet.headers["content-type"].startswith("text/csv")
    assert sheet.content.startswith(b"\xef\xbb\xbf")
    same = await engineer.post(
        f"{SETTINGS}/import", content=sheet.content, headers=CSV, params={"comment": "same"}
    )
    assert (same.status_code, same.json()["changed"]) == (200, 0)
    rows = list(csv.DictReader(io.StringIO(sheet.content.decode("utf-8-sig"))))
    assert {one["asset"] for one in rows} == {"bench-1", "bench-2"}
    for one in rows:
        one["remarks"] = "=HYPERLINK(1)" if one["asset"] == "bench-1" else ""
        if one["kind"] == "measured limit" and one["level"] == "alarm":
            one["setpoint"] = "90"
    edited = io.StringIO()
    writer = csv.DictWriter(edited, COLUMNS)
    writer.writeheader()
    writer.writerows(rows)
    content = edited.getvalue().encode()
    without = await engineer.post(f"{SETTINGS}/import", content=content, headers=CSV)
    assert (without.status_code, "comment" in without.text) == (422, True)
    done = await engineer.post(
        f"{SETTINGS}/import", content=content, headers=CSV, params={"comment": "review"}
    )
    assert done.status_code == 200, done.text
    again = (await engineer.get(SETTINGS, params={"format": "csv"})).content.decode()
    assert "'=HYPERLINK(1)" in again
    assert ",=" not in again
    # One revision for all of it.
    history = (await engineer.get(f"{SETTINGS}/history", params={"limit": 1000})).json()["items"]
    assert {one["revision"] for one in history} == {1}


async def test_one_mistake_refuses_the_sheet_and_a_dry_run_lists_all(settings: Any) -> None:
    engineer = settings.client("engineer")
    text = (
        "asset,tag,kind,level,setpoint\n"
        "bench-1,t_inner_ring_c,measured limit,warning,60\n"
        "bench-2,t_inner_ring_c,measured limit,warning,95\n"
        "bench-3,t_inner_ring_c,measured limit,warning,60\n"
    )
    post = {"content": text.encode(), "headers": CSV}
    tried = await engineer.post(f"{SETTINGS}/import", params={"dry_run": True}, **post)
    mistakes = [(one["row"], one["column"]) for one in tried.json()["mistakes"]]
    assert mistakes == [(3, "setpoint"), (4, "asset")]
    refused = await engineer.post(f"{SETTINGS}/import", params={"comment": "lower"}, **post)
    assert refused.status_code == 422
    assert [one["pointer"] for one in refused.json()["errors"]] == [
        "/rows/3/setpoint",
        "/rows/4/asset",
    ]
    assert settings.store.alarm_overlays.revision() == 0
    assert not settings.asked
    operator = await settings.client("operator").patch(SETTINGS, json=WARNING | {"comment": "no"})
    assert operator.status_code == 403


async def test_a_change_that_silences_an_alarm_stands_in_the_trail(settings: Any) -> None:
    condition = AlarmCondition(
        "bench-1", "measured limit", "t_inner_ring_c", "alarm", True, 96.0, "over alarm", 1,
        limit_value=95.0, unit="°C",
    )  # fmt: skip
    settings.alarms.evaluate(condition)
    engineer = settings.client("engineer")
    patch = ALARM | {"enabled": False, "comment": "noise"}
    done = (await engineer.patch(SETTINGS, json=patch)).json()
    assert [one["kind"] for one in done["silences"]] == ["measured limit"]
    (line,) = [one for one in settings.store.audit.page(10).items if "alarm_s" in one.action]
    assert (
        "silences active alarms: bench-1 measured limit t_inner_ring_c alarm (priority 1)"
        in line.detail
    )


async def test_a_cell_that_is_away_takes_it_up_later(settings: Any) -> None:
    async def away() -> dict[str, str]:
        raise CellUnavailableError("away")

    settings.have(apply_assets=away)
    patch = WARNING | {"setpoint": 65.0, "comment": "lower"}
    done = (await settings.client("engineer").patch(SETTINGS, json=patch)).json()
    assert (done["in_effect"], done["revision"]) == (False, 1)


async def test_pages_show_every_row_once(settings: Any) -> None:
    viewer = settings.client("viewer")
    whole = (await viewer.get(SETTINGS)).json()["items"]
    found, cursor = [], None
    while cursor is not None or not found:
        params = {"limit": 7} | ({"cursor": cursor} if cursor else {})
        page = (await viewer.get(SETTINGS, params=params)).json()
        found += page["items"]
        cursor = page["next"]
    assert found == whole
    assert (await viewer.get(SETTINGS, params={"asset": "bench-3"})).status_code == 422
    assert (await viewer.get(SETTINGS, params={"cursor": "eyJhZnRlciI6IngifQ"})).status_code == 422


async def test_the_time_to_respond_rests_on_kept_forecasts(settings: Any) -> None:
    viewer = settings.client("viewer")
    unknown = row((await viewer.get(SETTINGS)).json(), **WARNING)
    assert unknown["time_to_respond_p50_s"] is None
    assert "not known" in unknown["time_basis"]

    def forecast(labels: list[str], highest: int) -> IssuedForecast:
        # 60 °C now, then a straight line; from 70 to 95 °C the median takes 2500 s.
        leads = [600, 1200, 1800, 2400, 3600, 7200]
        rise = [[6000 + min(lead, highest) + k for k in (-200, -50, 0, 50, 200)] for lead in leads]
        quantiles = [[of_lead] for of_lead in rise]
        content = IssuedContent(
            [(7200.0, 2400.0, 2650.0, 23.0)], False, labels, ["t_inner_ring_c"], leads,
            [False] * len(leads), quantiles, {},
        )  # fmt: skip
        return IssuedForecast("bench-1", 1_000_000, 1, "period", content)

    kept = settings.store.part(KeptForecasts)
    kept.add([forecast(["not identified yet: prior parameters only"], 9000)])
    assert "not known" in row((await viewer.get(SETTINGS)).json(), **WARNING)["time_basis"]
    kept.add([forecast([], 9000), forecast([], 500)])
    shown = row((await viewer.get(SETTINGS)).json(), **WARNING)
    assert shown["time_to_respond_p50_s"] == pytest.approx(2500, abs=5)
    assert shown["time_to_respond_p05_s"] == pytest.approx(2500, abs=5)
    assert "1 of 2 kept forecasts" in shown["time_basis"]
    lead = row((await viewer.get(SETTINGS)).json(), **(ALARM | {"kind": "forecast limit"}))
    assert lead["time_to_respond_p50_s"] == pytest.approx(3500, abs=5)
    assert lead["time_to_respond_p05_s"] < lead["time_to_respond_p50_s"]
    assert "present forecast" not in lead["time_basis"]
    ahead = {"value": 1234.0, "unit": "s", "quality": 192, "time": "2026-11-23T00:00:00.000Z"}
    settings.bench.tags["t_inner_ring_c.time_to_alarm_s"] = ahead
    settings.context.changed("bench-1")
    lead = row((await viewer.get(SETTINGS)).json(), **(ALARM | {"kind": "forecast limit"}))
    assert lead["time_basis"].endswith("; present forecast: in 1234 s (median)")
    alarm = row((await viewer.get(SETTINGS)).json(), **ALARM)
    assert "no limit above the alarm" in alarm["time_basis"]
