"""Notifications of alarms: a test by button, a silence, and the sound of the browser."""

import json
import re
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import BrowserContext, Page, expect

from tests.browser.plant import BEARING, Plant
from tests.processes import wait_until

from .test_alarm_views import hot, row
from .test_page_quality import axe, violations_in_all_sizes

__all__ = ["axe", "hot"]

pytestmark = pytest.mark.browser

Screen = Callable[..., Page]
#: Every tone that really starts is counted; it sounds all the same.
COUNT_TONES = """
window.tones = 0;
const start = OscillatorNode.prototype.start;
OscillatorNode.prototype.start = function (...when) { window.tones += 1; start.apply(this, when); };
"""
PHONE = {"width": 390, "height": 800}


def test_a_test_is_sent_and_a_silence_planned_and_ended_by_keyboard_on_a_phone(
    screen: Screen, plant: Plant, axe: str, problems: list[str]
) -> None:
    page = screen("alarms", "engineer")
    panel = page.locator(".p-notifications")
    row = panel.locator('[data-notification="control-room"]')
    expect(row).to_contain_text("webhook to 127.0.0.1")
    page.set_viewport_size(PHONE)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    button = panel.get_by_role("button", name="Send a test to control-room")
    button.focus()
    with page.expect_response(re.compile(":test$")):
        page.keyboard.press("Enter")
    expect(page.locator(".note")).to_have_text("Test of control-room sent.")
    messages = [json.loads(body) for _, _, body in plant.hook.taken]
    assert "test" in [one["type"] for one in messages]

    panel.get_by_role("button", name="Silence…").press("Enter")
    dialog = page.get_by_role("dialog")
    page.evaluate(axe)
    assert not violations_in_all_sizes(page, "silence dialog")
    dialog.get_by_label("Alarms of").select_option(BEARING)
    dialog.get_by_label("Duration in minutes").fill("600")
    dialog.get_by_label("Reason").fill("bearing is being regreased")
    dialog.get_by_role("button", name="Silence", exact=True).press("Enter")
    silence = panel.locator("[data-silence]")
    expect(silence).to_contain_text(f"Silence: {BEARING}")
    expect(silence).to_contain_text("bearing is being regreased (engineer")
    assert not violations_in_all_sizes(page, "a silence")
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    silence.get_by_role("button").press("Enter")
    expect(silence).to_have_count(0)
    assert plant.get("/silences")["items"] == []
    actions = [line["action"] for line in plant.get("/audit")["items"]]
    assert [one for one in actions if one.startswith(("silence", "notification"))][:3] == [
        "silence.end", "silence.begin", "notification.test"
    ]  # fmt: skip
    assert problems == []


@pytest.mark.thorough
def test_who_may_not_test_or_silence_reads_why(screen: Screen, problems: list[str]) -> None:
    panel = screen("alarms", "viewer").locator(".p-notifications")
    button = panel.get_by_role("button", name="Send a test to control-room")
    expect(button).to_be_disabled()
    expect(button).to_have_attribute("title", re.compile("Needs the role engineer"))
    expect(panel.get_by_role("button", name="Silence…")).to_be_disabled()
    assert problems == []


@pytest.mark.thorough
def test_an_alarm_sounds_once_it_is_asked_for_until_it_is_acknowledged(
    screen: Screen, context: BrowserContext, plant: Plant, hot: dict[str, Any], problems: list[str]
) -> None:
    context.add_init_script(COUNT_TONES)
    page = screen("alarms", "operator")
    expect(row(page, hot)).to_have_attribute("data-state", "UNACK")
    page.wait_for_timeout(1000)
    assert tones(page) == 0, "silent until somebody asks"
    sound = page.locator("#alarm-sound")
    sound.select_option("1")
    count = tones(page)
    assert count >= 3, "a sample of what it sounds like"

    def acknowledge() -> bool:
        waiting = [
            one["id"]
            for one in plant.get("/alarms")["items"]
            if one["state"] == "UNACK" and one["priority"] == 1
        ]
        plant.client.post("/api/v1/alarms/acknowledge", json={"ids": waiting or ["none"]})
        return not waiting

    wait_until(acknowledge, 60, "no alarm of priority 1", every_s=0.2)
    count = tones(page)
    sound.select_option("2")
    wait_until(lambda: tones(page) >= count + 4, 60, "the tone of priority 2", every_s=0.1)
    page.reload()  # another visit of the same browser: it remembers, and waits for a click
    expect(sound).to_have_value("2")
    page.locator("h2").first.click()
    wait_until(lambda: tones(page), 60, "the tone after a click", every_s=0.1)

    def quiet() -> bool:
        for one in plant.get("/alarms")["items"]:
            if one["state"] == "UNACK":
                plant.client.post(f"/api/v1/alarms/{one['id']}/acknowledge")
        before = tones(page)
        page.wait_for_timeout(7000)  # longer than from one tone of priority 2 to the next
        return tones(page) == before

    wait_until(quiet, 120, "silence once all are acknowledged", every_s=0.1)
    assert problems == []


def tones(page: Page) -> int:
    return int(page.evaluate("window.tones"))
