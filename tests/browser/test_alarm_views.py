"""An alarm comes, is acknowledged, shelved, comes back by itself; the journal tells of it."""

import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.plant import BEARING, RATE, Plant
from tests.processes import wait_until

pytestmark = pytest.mark.browser

Screen = Callable[..., Page]
SHELVED_MIN = 30  # of process time: a slow page still shows it meanwhile
KIND = "measured limit"


@pytest.fixture
def hot(plant: Plant) -> Iterator[dict[str, Any]]:
    """The inner ring over its warning, with an alarm that nobody has seen."""
    plant.values[BEARING]["t_inner_ring_c"] = 81.0

    def raised() -> Any:
        alarm = plant.alarm(KIND)
        return alarm if alarm and alarm["state"] == "UNACK" else None

    alarm = wait_until(raised, 60, "an alarm over the warning")

    yield alarm
    plant.calm()

    def over() -> bool:
        waiting = [
            alarm["id"]
            for alarm in plant.get("/alarms", asset=BEARING)["items"]
            if alarm["state"] in ("UNACK", "RTNUN")
        ]
        plant.client.post("/api/v1/alarms/acknowledge", json={"ids": waiting or ["none"]})
        return plant.alarm(KIND) is None

    wait_until(over, 60, "an alarm that is over", every_s=0.5)


def row(page: Page, alarm: dict[str, Any]) -> Locator:
    return page.locator(f'.al[data-alarm="{alarm["id"]}"]')


def test_an_alarm_is_acknowledged_with_one_press(
    screen: Screen, hot: dict[str, Any], problems: list[str]
) -> None:
    page = screen(f"operator/{BEARING}", "operator")
    banner = page.locator("#banner")
    expect(page.locator('.ans[aria-label="Is it safe now"]')).to_have_class(re.compile("solid p2"))
    expect(row(page, hot)).to_have_attribute("data-state", "UNACK")
    assert row(page, hot).locator(".blink").count() == 1
    # The jump raises others, too, and some are more urgent: the banner takes them one by one.
    button = banner.get_by_role("button", name="Acknowledge")

    def acknowledged() -> bool:
        if row(page, hot).get_attribute("data-state") == "ACKED":
            return True
        with page.expect_response(lambda response: response.url.endswith("/acknowledge")):
            button.click()
        return False

    wait_until(acknowledged, 60, "an acknowledged alarm", every_s=0.5)
    expect(row(page, hot)).to_contain_text("ACKNOWLEDGED")
    expect(page.locator(".al[data-state=ACKED]").first).to_be_visible()
    assert problems == []


@pytest.mark.thorough
def test_a_shelved_alarm_comes_back_by_itself(
    screen: Screen, hot: dict[str, Any], problems: list[str]
) -> None:
    page = screen(f"operator/{BEARING}", "operator")
    # From its row: the banner shows whatever is most urgent by then.
    row(page, hot).get_by_role("button", name=re.compile("^More on")).click()
    page.get_by_role("dialog").get_by_role("button", name="Shelve").click()
    dialog = page.get_by_role("dialog")
    shelve = dialog.get_by_role("button", name="Shelve", exact=True)
    shelve.click()  # neither time nor reason: nothing happens
    expect(dialog).to_be_visible()
    dialog.get_by_label("Duration in minutes").fill("481")
    dialog.get_by_label("Reason").fill("thermocouple is being moved")
    shelve.click()  # more than 8 h
    expect(dialog).to_be_visible()
    dialog.get_by_label("Duration in minutes").fill(str(SHELVED_MIN))
    with page.expect_response(lambda response: response.url.endswith("/shelve")) as answer:
        dialog.get_by_label("Reason").press("Enter")
    assert answer.value.json()["state"] == "SHLVD"
    expect(row(page, hot)).to_have_attribute("data-state", "SHLVD")
    expect(row(page, hot)).to_contain_text(re.compile("SHELVED"))
    expect(page.locator("#banner")).not_to_contain_text("over warning")
    expect(row(page, hot)).to_have_attribute(
        "data-state", "UNACK", timeout=1000 * (SHELVED_MIN * 60 / RATE) + 60_000
    )
    assert problems == []


@pytest.mark.thorough
def test_bulk_acknowledge_comment_and_journal(
    screen: Screen, hot: dict[str, Any], problems: list[str]
) -> None:
    page = screen("alarms", "engineer")
    row(page, hot).get_by_role("button", name=re.compile("^More on")).click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("measured limit")
    expect(dialog.locator(".past li").first).to_contain_text("raised")
    dialog.get_by_role("button", name="Comment").click()
    page.get_by_label("Comment (goes to the journal)").fill("grease was changed")
    page.get_by_role("button", name="Save comment").click()
    line = page.locator(".jt tbody tr", has_text="grease was changed")
    expect(line).to_be_visible()

    bulk = page.get_by_role("button", name=re.compile("^Acknowledge .*selected"))
    expect(bulk).to_be_disabled()
    page.get_by_label("Select all unacknowledged").check()
    bulk.click()
    expect(row(page, hot)).to_have_attribute("data-state", "ACKED")
    acknowledged = page.locator(".jt tbody tr", has_text="acknowledged")
    expect(acknowledged.first).to_be_visible()
    page.get_by_role("searchbox").fill("grease was changed")
    expect(page.locator(".jt tbody tr")).to_have_count(1)
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save as CSV").click()
    assert "grease was changed" in saved.value.path().read_text(encoding="utf-8")
    figures = page.locator(".stats dd").first
    assert int(figures.inner_text()) >= 1
    assert problems == []


@pytest.mark.thorough
def test_out_of_service_and_back(screen: Screen, hot: dict[str, Any], problems: list[str]) -> None:
    page = screen(f"operator/{BEARING}", "engineer")
    row(page, hot).get_by_role("button", name=re.compile("^More on")).click()
    page.get_by_role("button", name="Out of service").click()
    page.get_by_label("Reason").fill("sensor is replaced")
    page.get_by_role("button", name="Take out of service").click()
    expect(row(page, hot)).to_have_attribute("data-state", "OOSRV")
    expect(row(page, hot)).to_contain_text("OUT OF SERVICE")
    row(page, hot).get_by_role("button", name=re.compile("^Return to service")).click()
    expect(row(page, hot)).to_have_attribute("data-state", "UNACK")
    assert problems == []


@pytest.mark.thorough
def test_what_is_not_there_is_shelved_and_taken_out_before_it_comes(
    screen: Screen, problems: list[str]
) -> None:
    page = screen("alarms", "engineer")
    page.get_by_text("Normal (inactive) alarms").click()
    # By its text: once it has been there, the condition that is watched on is another one.
    row = page.locator(".al", has_text=re.compile("Inner ring over alarm"))
    expect(row).to_have_attribute("data-state", "NORM")
    row.get_by_role("button", name=re.compile("^Shelve")).click()
    page.get_by_label("Duration in minutes").fill("480")
    page.get_by_label("Reason").fill("hot air is blown at it")
    page.get_by_role("dialog").get_by_role("button", name="Shelve", exact=True).click()
    expect(row).to_have_attribute("data-state", "SHLVD")
    row.get_by_role("button", name=re.compile("^Unshelve")).click()
    expect(row).to_have_attribute("data-state", "NORM")
    row.get_by_role("button", name=re.compile("^Out of service")).click()
    page.get_by_label("Reason").fill("sensor is replaced")
    page.get_by_role("button", name="Take out of service").click()
    expect(row).to_have_attribute("data-state", "OOSRV")
    row.get_by_role("button", name=re.compile("^Return to service")).click()
    expect(row).to_have_attribute("data-state", "NORM")
    assert problems == []


@pytest.mark.thorough
def test_a_viewer_sees_the_alarm_and_cannot_answer_it(screen: Screen, hot: dict[str, Any]) -> None:
    page = screen(f"operator/{BEARING}", "viewer")
    button = row(page, hot).get_by_role("button", name=re.compile("^Acknowledge"))
    expect(button).to_be_disabled()
    expect(button).to_have_attribute("title", re.compile("Needs the role operator"))
    expect(page.locator("#banner").get_by_role("button", name="Acknowledge")).to_be_disabled()


@pytest.mark.thorough
def test_the_history_marks_the_alarm_and_a_node_leads_to_it(
    screen: Screen, hot: dict[str, Any], problems: list[str]
) -> None:
    page = screen(f"operator/{BEARING}")
    page.locator('.sect .ring[data-pin="4"]').click()
    expect(page).to_have_url(re.compile(rf"#history/{BEARING}\?channel=t_inner_ring_c"))
    expect(page.get_by_role("checkbox", name=re.compile("^Inner ring ?°"))).to_be_checked()
    expect(page.get_by_role("checkbox", name=re.compile("^Outer ring ?°"))).not_to_be_checked()
    mark = page.locator(".ribbon a", has_text=hot["message"]).last
    expect(mark).to_have_attribute("title", re.compile("raised"))
    plot = page.locator(".p-past .t .u-over").bounding_box()
    place = mark.bounding_box()
    assert plot is not None
    assert place is not None
    assert plot["x"] <= place["x"] + place["width"] / 2 <= plot["x"] + plot["width"]
    mark.click()
    expect(page).to_have_url(re.compile("#alarms"))
    assert problems == []
