"""Alarm settings on the page: edited by keyboard, imported with a preview, undone."""

import csv
import io
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.plant import BEARING, Plant
from tests.processes import wait_until

from .test_page_quality import axe, violations_in_all_sizes

__all__ = ["axe"]

pytestmark = pytest.mark.browser

Screen = Callable[..., Page]
PHONE = {"width": 390, "height": 800}
SETTINGS = "/alarm-settings"
WARNING = {"asset": BEARING, "tag": "t_inner_ring_c", "kind": "measured limit", "level": "warning"}
NAME = "Inner ring: measured limit (warning)"


@pytest.fixture
def settings(plant: Plant) -> Iterator[Plant]:
    yield plant
    body = {"rows": [WARNING | {"setpoint": None, "remarks": None}], "comment": "as it was"}
    plant.client.post("/api/v1/alarm-settings/import", json=body)


def warning(plant: Plant) -> Any:
    items = plant.get(SETTINGS, asset=BEARING, limit=1000)["items"]
    return next(one for one in items if WARNING.items() <= one.items())


def opened(page: Page) -> Locator:
    panel = page.locator(".p-settings")
    panel.locator("summary").press("Enter")
    panel.get_by_label("Asset of the settings").select_option(BEARING)
    expect(panel.locator("tbody tr").first).to_be_visible()
    return panel


def test_a_setting_is_edited_and_undone_by_keyboard_on_a_phone(
    screen: Screen, settings: Plant, axe: str, problems: list[str]
) -> None:
    page = screen("alarms", "engineer")
    loaded: list[str] = []
    page.on("request", lambda request: loaded.append(request.url))
    panel = page.locator(".p-settings")
    expect(panel).to_be_visible()
    assert not [url for url in loaded if "alarm_setting" in url or SETTINGS in url]
    panel = opened(page)
    panel.get_by_label("Filter alarms").fill("inner ring: measured limit (warning)")
    expect(panel.locator("tbody tr")).to_have_count(1)
    page.evaluate(axe)
    assert not violations_in_all_sizes(page, "alarm settings")
    page.set_viewport_size(PHONE)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    panel.get_by_role("button", name=f"Edit {NAME}").press("Enter")
    dialog = page.get_by_role("dialog")
    assert not violations_in_all_sizes(page, "dialog of a setting")
    dialog.get_by_label("Setpoint, °C").fill("66.5")
    dialog.get_by_label("Remarks").fill("=1+1")
    dialog.get_by_label("Reason").fill("as the maker says")
    dialog.get_by_role("button", name="Check the change").press("Enter")
    expect(dialog).to_contain_text("Change these settings?")
    expect(
        dialog.get_by_role("row", name=re.compile("measured limit.*warning setpoint 70 66.5"))
    ).to_be_visible()
    assert not violations_in_all_sizes(page, "differences")
    dialog.get_by_role("button", name="Change", exact=True).press("Enter")
    expect(panel.get_by_text("1 alarm changed, in effect now.")).to_be_visible()
    assert (warning(settings)["setpoint"], warning(settings)["remarks"]) == (66.5, "=1+1")
    limits = settings.get(f"/assets/{BEARING}")["limits"]
    assert limits["t_inner_ring_c"]["warning"] == 66.5
    panel.get_by_role("button", name="History").press("Enter")
    undo = panel.get_by_role("button", name=re.compile("Undo setpoint: 66.5"))
    expect(panel.locator(".notices li").first).to_contain_text("as the maker says")
    assert not violations_in_all_sizes(page, "history of settings")
    undo.first.press("Enter")
    page.get_by_role("dialog").get_by_role("button", name="Change", exact=True).press("Enter")
    wait_until(lambda: warning(settings)["setpoint"] == 70, 60, "the undone setpoint")
    assert problems == []


@pytest.mark.thorough
def test_a_sheet_is_exported_checked_and_imported(
    screen: Screen, settings: Plant, tmp_path: Path, problems: list[str]
) -> None:
    page = screen("alarms", "engineer")
    panel = opened(page)
    with page.expect_download() as saved:
        panel.get_by_role("button", name="Export CSV").click()
    text = Path(saved.value.path()).read_text(encoding="utf-8-sig")
    rows = list(csv.DictReader(io.StringIO(text)))
    row = next(one for one in rows if WARNING.items() <= one.items())
    for setpoint, said in (("warm", "expected a number"), ("65", None)):
        row["setpoint"] = setpoint
        out = io.StringIO()
        writer = csv.DictWriter(out, list(row))
        writer.writeheader()
        writer.writerows(rows)
        file = tmp_path / f"{setpoint}.csv"
        file.write_text(out.getvalue(), encoding="utf-8")
        panel.get_by_label("Import CSV").set_input_files(file)
        if said:
            line = rows.index(row) + 2
            expect(panel).to_contain_text(f"Line {line}, setpoint: 'warm': {said}")
    panel.get_by_label("Reason").fill("review")
    assert warning(settings)["setpoint"] == 70
    panel.get_by_role("button", name="Import 1 alarm").click()
    expect(panel.get_by_text("1 alarm changed, in effect now.")).to_be_visible()
    assert warning(settings)["setpoint"] == 65
    assert problems == []


@pytest.mark.thorough
def test_a_viewer_reads_and_changes_nothing(screen: Screen, settings: Plant) -> None:
    panel = opened(screen("alarms", "viewer"))
    button = panel.get_by_role("button", name=re.compile("^Edit ")).first
    expect(button).to_be_disabled()
    expect(button).to_have_attribute("title", re.compile("Needs the role engineer"))
    expect(panel.get_by_label("Import CSV")).to_be_disabled()
