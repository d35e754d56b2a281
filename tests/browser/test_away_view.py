"""A service that no longer answers: the whole page says so and takes no orders."""

import os
import re
import signal
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.browser.plant import BEARING, Plant

pytestmark = pytest.mark.browser


def test_a_frozen_service_is_noticed_and_its_return_too(
    screen: Callable[..., Page], plant: Plant
) -> None:
    """No socket breaks here: only that nothing comes any more tells the page."""
    page = screen(f"operator/{BEARING}")
    now = page.locator('.ans[aria-label="Is it safe now"] .word')
    expect(now).to_have_text(re.compile("Safe"))
    assert plant.service is not None
    web = plant.service.side("web")
    os.kill(web, signal.SIGSTOP)
    try:
        expect(page.locator("#lost")).to_contain_text("Connection lost")
        expect(page.locator("body")).to_have_class(re.compile("away"))
        expect(now).to_have_text("Unknown")
        expect(page.locator(".clock")).to_have_text(re.compile("old"))
        # An alarm that a test before has left is told as the last known one.
        expect(page.locator("#banner")).to_contain_text(re.compile("Alarms unknown|LAST KNOWN"))
        assert page.locator("main").evaluate("(main) => main.inert")
        page.get_by_role("button", name="12 h").focus()
        assert page.evaluate("document.activeElement === document.body")
        expect(page.locator("#lost")).to_contain_text(re.compile("next try in|Retrying"))
    finally:
        os.kill(web, signal.SIGCONT)
    page.evaluate("document.querySelector('#lost .btn')?.click()")  # it may be back by itself
    expect(page.locator("#lost")).to_be_empty()
    expect(page.locator("#banner")).not_to_contain_text(re.compile("unknown:|LAST KNOWN"))
    expect(now).to_have_text(re.compile("Safe"))
    assert not page.locator("main").evaluate("(main) => main.inert")


def test_a_frozen_cell_leaves_no_verdict_on_the_page(
    screen: Callable[..., Page], plant: Plant
) -> None:
    """The web side still answers, but what it knows of the machine is old."""
    page = screen(f"operator/{BEARING}")
    now = page.locator('.ans[aria-label="Is it safe now"] .word')
    expect(now).to_have_text(re.compile("Safe"))
    assert plant.service is not None
    cell = plant.service.side("cell")
    os.kill(cell, signal.SIGSTOP)
    try:
        expect(now).to_have_text("Unknown")
    finally:
        os.kill(cell, signal.SIGCONT)
    expect(now).to_have_text(re.compile("Safe"))
