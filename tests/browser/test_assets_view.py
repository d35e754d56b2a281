"""Assets are added, imported and removed on the page; every list of it follows without a reload."""

import json
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import pytest
from patience import patience
from playwright.sync_api import BrowserContext, Locator, Page, Route, expect
from processes import wait_until

from service.features.nights.tables import FleetRuns
from service.site.settings import load_settings
from service.store import Store
from tests.browser.assets_hall import ALONE, IN_FILE, EmptyHall, Hall
from tests.browser.conftest import WAIT_MS
from tests.browser.plant import Plant
from tests.browser.test_page_quality import violations_in_all_sizes
from tests.service.features.nights.test_tables import RUN

pytestmark = pytest.mark.browser

PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def started_plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with Hall(tmp_path_factory.mktemp("hall")) as hall:
        hall.start()
        yield hall


@pytest.fixture
def hall(plant: Plant) -> Iterator[Hall]:
    """The service with the asset of its file alone."""
    assert isinstance(plant, Hall)
    yield plant
    for asset in plant.provisioned():
        assert plant.client.delete(f"/api/v1/assets/{asset}").is_success


Screen = Callable[..., Page]


def row(page: Page, asset: str) -> Locator:
    return page.locator(f'tr[data-asset="{asset}"]')


def tabs(page: Page) -> Locator:
    return page.locator("nav.tabs a")


def overflow_px(page: Page) -> int:
    wider: int = page.evaluate(
        "document.documentElement.scrollWidth - document.documentElement.clientWidth"
    )
    return wider


def test_an_asset_is_added_from_a_template_and_removed_again(
    screen: Screen, hall: Hall, problems: list[str]
) -> None:
    page = screen("assets")
    expect(row(page, IN_FILE)).to_contain_text("configuration file")
    expect(row(page, IN_FILE).get_by_role("button")).to_have_count(0)
    expect(tabs(page).filter(has_text="Fleet")).to_have_count(0)  # of one asset there is no fleet
    page.get_by_role("button", name="Add asset…").press("Enter")
    expect(page.get_by_label("Template", exact=True)).to_be_focused()
    page.get_by_label("Id", exact=True).fill("axle-1")
    page.get_by_label("Name (optional)").fill("Car 3, axle 1")
    expect(page.get_by_text('Empty: "A", from the template.')).to_be_visible()
    page.get_by_label("warning", exact=True).fill("warm")
    page.get_by_role("button", name="Add asset", exact=True).click()
    expect(page.get_by_role("alert").filter(has_text="was not added")).to_be_visible()
    page.get_by_label("warning", exact=True).fill("72.5")
    page.get_by_label("warning", exact=True).press("Enter")
    expect(page.get_by_text("Asset axle-1 added.")).to_be_visible()
    expect(page.get_by_role("button", name="Add asset…")).to_be_focused()
    assert hall.provisioned() == {
        "axle-1": {"template": "axle", "name": "Car 3, axle 1", "values": {"warning": 72.5}}
    }
    assert hall.get("/assets/axle-1")["limits"]["t_inner_ring_c"]["warning"] == 72.5
    expect(row(page, "axle-1")).to_contain_text("Line A")
    expect(row(page, "axle-1")).to_contain_text("provisioned")
    # The other views know it, and the page was not loaded again.
    tabs(page).filter(has_text="Fleet").click()
    expect(page.locator(".card", has_text="Car 3, axle 1")).to_be_visible()
    expect(page.locator("#banner")).not_to_contain_text("loading")
    page.locator(".card", has_text="Car 3, axle 1").click()
    expect(page.get_by_label("Asset", exact=True)).to_have_value("axle-1")
    tabs(page).filter(has_text="Assets").click()
    row(page, "axle-1").get_by_role("button", name="Remove Car 3, axle 1").click()
    question = page.get_by_role("dialog")
    expect(question).to_contain_text("Remove the asset Car 3, axle 1 (axle-1)?")
    expect(question).to_contain_text("stay in the database")
    question.get_by_role("button", name="Cancel").click()
    expect(row(page, "axle-1")).to_be_visible()
    assert all("422" in one for one in problems), "the browser reports the one answer 422"
    row(page, "axle-1").get_by_role("button", name="Remove Car 3, axle 1").click()
    question.get_by_role("button", name="Remove asset").click()
    expect(page.get_by_text("Asset axle-1 removed. Its history is kept.")).to_be_visible()
    expect(row(page, "axle-1")).to_have_count(0)
    expect(tabs(page).filter(has_text="Fleet")).to_have_count(0)
    assert hall.provisioned() == {}
    # And since then what was asked of the asset while it was removed.
    assert all("422" in one or "404" in one for one in problems), problems


@pytest.mark.thorough
def test_an_asset_is_edited_and_what_others_changed_stays(
    screen: Screen, hall: Hall, problems: list[str]
) -> None:
    hall.put("axle-1", "First")
    table = {"template": "axle", "name": "First", "values": {"warning": 70, "line": "007"}}
    assert hall.client.put("/api/v1/assets/axle-1", json=table).is_success
    page = screen("assets")
    row(page, "axle-1").get_by_role("button", name="Edit First").click()
    expect(page.get_by_role("heading", name="Edit the asset axle-1")).to_be_visible()
    expect(page.get_by_label("Id", exact=True)).to_have_count(0)
    expect(page.get_by_label("warning", exact=True)).to_have_value("70")
    expect(page.get_by_label("line", exact=True)).to_have_value("007")
    hall.client.patch("/api/v1/assets/axle-1", json={"group": "North"})  # somebody else
    page.get_by_label("Name (optional)").fill("Other")
    page.get_by_label("warning", exact=True).fill("71.5")
    page.get_by_role("button", name="Save asset").click()
    expect(page.get_by_text("Asset axle-1 changed.")).to_be_visible()
    expect(row(page, "axle-1")).to_contain_text("Other")
    assert hall.provisioned()["axle-1"] == {
        "template": "axle",
        "name": "Other",
        "group": "North",
        "values": {"warning": 71.5, "line": "007"},
    }
    row(page, "axle-1").get_by_role("button", name="Edit Other").click()
    page.get_by_label("Template", exact=True).select_option("whole configuration as JSON")
    configuration = page.get_by_label("Configuration", exact=True)
    changed = json.loads(configuration.input_value())
    del changed["group"]
    configuration.fill(json.dumps(changed | {"limits": {"t_inner_ring_c": {"alarm": 60}}}))
    page.get_by_role("button", name="Save asset").click()
    expect(page.get_by_text("The asset was not changed.")).to_be_visible()
    configuration.fill(json.dumps(changed | {"limits": {"t_inner_ring_c": {"alarm": 90}}}))
    page.get_by_role("button", name="Save asset").click()
    expect(page.get_by_text("Asset axle-1 changed.")).to_be_visible()
    kept = hall.provisioned()["axle-1"]
    assert ("group" in kept, kept["limits"]) == (False, {"t_inner_ring_c": {"alarm": 90}})
    assert all("422" in one for one in problems)


@pytest.mark.thorough
def test_adding_overwrites_no_asset_that_does_not_run(screen: Screen, hall: Hall) -> None:
    page = screen("assets")
    page.get_by_role("button", name="Add asset…").click()
    hall.put("axle-1", "Made elsewhere")  # the page does not know it yet
    page.get_by_label("Id", exact=True).fill("axle-1")
    page.get_by_label("warning", exact=True).fill("60")
    page.get_by_role("button", name="Add asset", exact=True).click()
    expect(page.get_by_text("There is an asset axle-1 already.")).to_be_visible()
    expect(page.get_by_label("Id", exact=True)).to_be_focused()
    assert hall.provisioned()["axle-1"]["name"] == "Made elsewhere"


@pytest.mark.thorough
def test_many_are_removed_at_once(screen: Screen, hall: Hall, problems: list[str]) -> None:
    for number in range(1, 5):
        hall.put(f"axle-{number}")
    page = screen("assets")
    expect(page.get_by_role("button", name=re.compile("^Remove .* selected"))).to_be_hidden()
    expect(row(page, IN_FILE).get_by_role("checkbox")).to_have_count(0)
    row(page, "axle-1").get_by_role("checkbox").check()
    page.get_by_label("Search assets").fill("axle-3")
    everything = page.get_by_role("checkbox", name="Select all assets found")
    everything.check()
    page.get_by_label("Search assets").fill("")
    expect(row(page, "axle-1").get_by_role("checkbox")).to_be_checked()
    expect(row(page, "axle-2").get_by_role("checkbox")).not_to_be_checked()
    page.get_by_role("button", name="Remove 2 selected…").click()
    question = page.get_by_role("dialog")
    expect(question.get_by_role("listitem")).to_have_text(["axle-1", "axle-3"])
    question.get_by_role("button", name="Remove 2 assets").click()
    expect(page.get_by_text("2 assets removed. Their history is kept.")).to_be_visible()
    expect(row(page, "axle-3")).to_have_count(0)
    assert sorted(hall.provisioned()) == ["axle-2", "axle-4"]
    assert problems == []


@pytest.mark.thorough
def test_an_asset_without_a_template_is_given_as_json(screen: Screen, hall: Hall) -> None:
    page = screen("assets")
    page.get_by_role("button", name="Add asset…").click()
    page.get_by_label("Template", exact=True).select_option("none (configuration as JSON)")
    page.get_by_label("Id", exact=True).fill("spindle-1")
    table = page.get_by_label("Configuration", exact=True)
    table.fill('{"bearing": ')
    page.get_by_role("button", name="Add asset", exact=True).click()
    expect(page.get_by_text("Not valid JSON")).to_be_visible()
    expect(table).to_be_focused()
    table.fill(json.dumps(ALONE))
    page.get_by_role("button", name="Add asset", exact=True).click()
    expect(row(page, "spindle-1")).to_contain_text("Spindle")
    expect(row(page, "spindle-1")).to_contain_text("none")
    assert hall.provisioned() == {"spindle-1": ALONE}


@pytest.mark.thorough
def test_a_faulty_csv_file_names_its_rows_and_its_good_rows_are_imported(
    screen: Screen, hall: Hall, tmp_path: Path, problems: list[str]
) -> None:
    hall.put("axle-1")
    page = screen("assets")
    faulty = tmp_path / "fleet.csv"
    faulty.write_text(
        "id,template,name,warning,colour\n"
        "axle-1,axle,First,71,\n"  # line 2: another name and value
        "axle-2,axle,Second,70,\n"
        "axle-3,axel,Third,70,\n"  # line 4: no such template
        "axle-4,axle,Fourth,,\n"  # line 5: no value
        "axle-5,axle,Fifth,70,red\n"  # line 6: what nobody asks for
        "axle-6,axle,Sixth,70,\n"
        "axle-6,axle,Sixth,70,\n"  # lines 7 and 8: one id
    )
    page.get_by_role("button", name="Import CSV…").click()
    expect(page.get_by_label("CSV file", exact=True)).to_be_focused()
    page.get_by_label("CSV file", exact=True).set_input_files(faulty)
    summary = page.locator(".p-import [role=status]")
    expect(summary).to_have_text("fleet.csv: 1 new, 1 changed, 0 unchanged, 5 rows with errors.")
    faults = page.locator("table.ft tbody tr")
    expect(faults).to_have_count(5)
    for number, (line, asset, field, reason) in enumerate(
        (
            ("4", "axle-3", "template", "axel"),
            ("5", "axle-4", "values.warning", "missing; template 'axle' asks for it"),
            ("6", "axle-5", "values.colour", "template 'axle' does not ask for it"),
            ("7", "axle-6", "id", "expected unique"),
            ("8", "axle-6", "id", "expected unique"),
        )
    ):
        cells = faults.nth(number).locator("td")
        expect(cells.nth(0)).to_contain_text(line)
        expect(cells.nth(1)).to_have_text(asset)
        expect(cells.nth(2)).to_have_text(field)
        expect(cells.nth(3)).to_contain_text(reason)
        expect(cells.nth(3)).not_to_have_text(re.compile(r"^row \d"))
    assert list(hall.provisioned()) == ["axle-1"]  # so far it was only looked at
    page.get_by_role("button", name="Import the 2 good rows").click()
    expect(page.locator(".p-assets [role=status]")).to_have_text(
        "1 asset added, 1 changed, 5 rows not imported."
    )
    expect(row(page, "axle-2")).to_contain_text("Second")
    expect(row(page, "axle-1")).to_contain_text("First")
    assert sorted(hall.provisioned()) == ["axle-1", "axle-2"]

    right = tmp_path / "rest.csv"
    right.write_text("id,template,warning\naxle-3,axle,70\naxle-2,axle,70\n")
    page.get_by_role("button", name="Import CSV…").click()
    page.get_by_label("CSV file", exact=True).set_input_files(right)
    page.get_by_role("button", name="Import 2 assets").click()
    expect(row(page, "axle-3")).to_be_visible()
    page.get_by_role("button", name="Import CSV…").click()
    page.get_by_label("CSV file", exact=True).set_input_files(right)
    expect(summary).to_have_text(
        "rest.csv: 0 new, 0 changed, 2 unchanged, 0 rows with errors. Nothing to import."
    )
    expect(page.get_by_role("button", name=re.compile("^Import [0-9t]"))).to_have_count(0)
    assert problems == []

    broken = tmp_path / "broken.csv"
    broken.write_text("name,template\nFirst,axle\n")
    page.get_by_label("CSV file", exact=True).set_input_files(broken)
    expect(summary).to_contain_text("broken.csv cannot be imported: ")
    expect(summary).to_contain_text("missing column 'id'")


@pytest.mark.thorough
def test_an_asset_that_somebody_else_makes_and_removes_is_followed(
    screen: Screen, hall: Hall, problems: list[str]
) -> None:
    page = screen("assets")
    expect(row(page, IN_FILE)).to_be_visible()
    hall.put("axle-7", "Made elsewhere")
    expect(row(page, "axle-7")).to_contain_text("Made elsewhere")
    page.goto(f"{hall.address}/#operator/axle-7")
    expect(page.get_by_label("Asset", exact=True)).to_have_value("axle-7")
    hall.client.delete("/api/v1/assets/axle-7")
    expect(page.get_by_text("Unknown asset “axle-7”.")).to_be_visible()
    page.goto(f"{hall.address}/#operator")
    expect(page.locator(".ans .word").first).to_be_visible()
    assert all("404" in one for one in problems)  # it was looked at when it went


@pytest.mark.thorough
def test_what_was_refused_of_an_asset_is_asked_for_again(screen: Screen, hall: Hall) -> None:
    page = screen("assets")
    expect(row(page, IN_FILE)).to_be_visible()
    asked = "**/axle-1/verdict"
    page.route(asked, lambda route: route.fulfill(status=503, json={"title": "not yet"}))
    hall.put("axle-1")
    with page.expect_response(asked, timeout=patience(WAIT_MS)) as refused:
        row(page, "axle-1").get_by_role("link").click()
    assert refused.value.status == 503
    page.unroute(asked)
    with page.expect_response(asked, timeout=patience(WAIT_MS)) as answered:
        pass
    assert answered.value.ok


@pytest.mark.thorough
def test_who_may_change_nothing_sees_why(screen: Screen, hall: Hall) -> None:
    hall.put("axle-1")
    page = screen("assets", "engineer")
    for name in ("Add asset…", "Import CSV…", "Edit axle-1", "Remove axle-1"):
        button = page.get_by_role("button", name=name)
        expect(button).to_be_disabled()
        expect(button).to_have_attribute("title", re.compile("Needs the role admin"))


@pytest.mark.thorough
def test_an_operator_has_no_such_view(screen: Screen, hall: Hall) -> None:
    page = screen("assets", "operator")
    expect(tabs(page).filter(has_text="Alarms")).to_be_visible()
    expect(tabs(page).filter(has_text="Assets")).to_have_count(0)
    expect(page.locator(".note")).to_contain_text("Needs the role engineer")
    expect(page.locator("h1")).not_to_have_text("Assets")


@pytest.mark.thorough
def test_many_assets_are_searched_and_shown_in_parts(
    screen: Screen, hall: Hall, tmp_path: Path
) -> None:
    rows = [f"unit-{number:03d},axle,70" for number in range(1, 121)]
    answer = hall.client.post(
        "/api/v1/assets:import",
        content="\n".join(["id,template,warning", *rows]),
        headers={"Content-Type": "text/csv"},
        timeout=WAIT_MS / 1000,
    )
    assert answer.json()["created"] == 120
    page = screen("assets")
    shown = page.locator("table.at tbody tr")
    expect(page.locator(".p-assets header")).to_contain_text(
        "121 assets: 1 in the configuration file"
    )
    expect(shown).to_have_count(100)
    page.get_by_role("button", name="Show 100 more").click()
    expect(shown).to_have_count(121)
    page.get_by_label("Search assets").fill("unit-11")
    expect(shown).to_have_count(10)


@pytest.mark.thorough
def test_forms_and_faults_meet_wcag_aa(screen: Screen, hall: Hall, tmp_path: Path) -> None:
    hall.put("axle-1")
    page = screen("assets")
    page.evaluate(files("axe_playwright_python").joinpath("axe.min.js").read_text("utf-8"))
    page.get_by_role("button", name="Add asset…").click()
    page.get_by_label("Template", exact=True).select_option("none (configuration as JSON)")
    page.get_by_label("Id", exact=True).fill("axle-2")
    page.get_by_label("Configuration", exact=True).fill("{")
    page.get_by_role("button", name="Add asset", exact=True).click()
    expect(page.get_by_text("Not valid JSON")).to_be_visible()
    found = violations_in_all_sizes(page, "form")
    page.get_by_role("button", name="Import CSV…").click()
    faulty = tmp_path / "fleet.csv"
    faulty.write_text("id,template\naxle-3,axle\n")
    page.get_by_label("CSV file", exact=True).set_input_files(faulty)
    expect(page.locator("table.ft")).to_be_visible()
    found += violations_in_all_sizes(page, "import")
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Edit axle-1").click()
    expect(page.get_by_label("warning", exact=True)).to_have_value("70")
    found += violations_in_all_sizes(page, "edit")
    page.get_by_role("button", name="Remove axle-1").click()
    expect(page.get_by_role("dialog")).to_be_visible()
    found += violations_in_all_sizes(page, "question")
    assert not found, "\n".join(found)


@pytest.mark.thorough
def test_nights_show_how_far_they_are_and_what_they_cost(screen: Screen, hall: Hall) -> None:
    page = screen("assets", "engineer")
    expect(row(page, IN_FILE)).to_be_visible()
    panel = page.locator(".p-nights")
    expect(panel).to_be_hidden()
    settings = load_settings(hall.configuration)
    now_us = time.time_ns() // 1000
    before = replace(RUN, id="1", night="2026-11-21", began_us=now_us - 10, ended_us=now_us)
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        for run in (before, replace(RUN, id="2", began_us=now_us, told_us=now_us)):
            store.part(FleetRuns).save(run)
    page.reload()
    expect(panel.locator("tbody tr")).to_have_count(2)
    expect(panel.get_by_role("status")).to_have_text(
        "The nightly run of 2026-11-22 is running (all assets): 52 of 100 assets, on 2 workers."
    )
    expect(panel.get_by_role("progressbar")).to_have_js_property("value", 0.52)
    cells = panel.locator("tbody tr").first.locator("td")
    expect(cells.nth(2)).to_have_text("Done: 40 of 100")
    expect(cells.nth(5)).to_have_text("Skipped: 10 (4 without new data)")
    expect(cells.nth(8)).to_have_text("Per asset: 0.50 s")
    expect(panel.locator("tbody tr").last).to_contain_text("stopped before the end")
    expect(panel.get_by_role("listitem")).to_have_text("m-1: 3 workers died of it")
    page.evaluate(files("axe_playwright_python").joinpath("axe.min.js").read_text("utf-8"))
    assert not violations_in_all_sizes(page, "nights")
    page.set_viewport_size(PHONE)  # type: ignore[arg-type]
    assert overflow_px(page) <= 0


@pytest.mark.thorough
def test_the_view_fits_a_phone(context: BrowserContext, screen: Screen, hall: Hall) -> None:
    hall.put("axle-1", "The left axle of the third car of the morning train to the north")
    page = screen("assets")
    page.set_viewport_size(PHONE)  # type: ignore[arg-type]
    expect(row(page, "axle-1")).to_contain_text("Template: axle")
    assert overflow_px(page) <= 0
    page.get_by_role("button", name="Add asset…").click()
    expect(page.get_by_label("warning", exact=True)).to_be_visible()
    assert overflow_px(page) <= 0


@pytest.mark.usefixtures("hall")
def test_the_form_waits_for_the_templates(screen: Screen, problems: list[str]) -> None:
    """Who is quicker than the answer would get a form for an asset without a template."""
    page = screen("assets")
    expect(row(page, IN_FILE)).to_be_visible()
    held: list[Route] = []
    page.route("**/api/v1/provisioning*", lambda route: held.append(route))
    page.reload()
    expect(row(page, IN_FILE)).to_be_visible()
    page.get_by_role("button", name="Add asset…").click()
    wait_until(lambda: page.wait_for_timeout(50) or held, 60, "the question for the templates")
    expect(page.get_by_label("Id", exact=True)).to_be_hidden()
    for route in held:
        route.continue_()
    expect(page.get_by_label("warning", exact=True)).to_be_visible()
    assert not problems


@pytest.mark.thorough
def test_the_first_asset_of_all_is_made_on_the_page(
    context: BrowserContext, tmp_path: Path
) -> None:
    with EmptyHall(tmp_path) as hall:
        hall.start()
        page = context.new_page()
        page.set_default_timeout(WAIT_MS)
        page.goto(f"{hall.address}/#key={hall.key}")
        expect(page.get_by_text("No asset is configured yet.")).to_be_visible()
        expect(tabs(page)).to_have_text(["Assets"])
        page.get_by_role("button", name="Add asset…").click()
        page.get_by_label("Id", exact=True).fill("axle-1")
        page.get_by_label("warning", exact=True).fill("70")
        page.get_by_role("button", name="Add asset", exact=True).click()
        row(page, "axle-1").get_by_role("link", name="axle-1").click()
        expect(tabs(page).filter(has_text="Operator")).to_have_attribute("aria-current", "page")
        tabs(page).filter(has_text="Assets").click()
        row(page, "axle-1").get_by_role("button", name="Remove axle-1").click()
        page.get_by_role("button", name="Remove asset").click()
        expect(page.get_by_text("No asset is configured yet.")).to_be_visible()
        expect(tabs(page)).to_have_text(["Assets"])
