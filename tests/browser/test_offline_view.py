"""A service that no longer answers: the whole page says so and takes no orders."""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.browser.plant import BEARING, Plant
from tests.browser.test_dashboard import fan_pixels
from tests.processes import wait_until

pytestmark = pytest.mark.browser

#: What tile, banner and chips say from the moment on at which the strip of lost data goes.
WATCH_THE_RETURN = """() => {
  window.seen = [];
  const text = (selector) => document.querySelector(selector)?.textContent ?? '';
  const look = () => {
    if (text('#lost') === '' && !document.body.classList.contains('offline')) {
      window.seen.push([text('.ans'), text('#banner'), text('.conn')]);
    }
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
}"""


@pytest.mark.thorough
def test_a_frozen_service_is_noticed_and_its_return_too(
    screen: Callable[..., Page], plant: Plant
) -> None:
    """No socket breaks here: only that nothing comes any more tells the page."""
    page = screen(f"operator/{BEARING}")
    now = page.locator('.ans[aria-label="Is it safe now"] .word')
    expect(now).to_have_text(re.compile("Safe"))
    wait_until(lambda: fan_pixels(page) > 2000, 60, "a forecast fan on the canvas")
    assert plant.service is not None
    with plant.service.frozen("web"):
        expect(page.locator("#lost")).to_contain_text("Connection lost")
        expect(page.locator("body")).to_have_class(re.compile("offline"))
        expect(now).to_have_text("Unknown")
        wait_until(lambda: fan_pixels(page) == 0, 30, "no forecast is drawn any more")
        expect(page.locator(".clock")).to_have_text(re.compile("old"))
        # An alarm that a test before has left is told as the last known one.
        expect(page.locator("#banner")).to_contain_text(re.compile("Alarms unknown|LAST KNOWN"))
        assert page.locator("main").evaluate("(main) => main.inert")
        page.get_by_role("button", name="12 h").focus()
        assert page.evaluate("document.activeElement === document.body")
        expect(page.locator("#lost")).to_contain_text(re.compile("next try in|Retrying"))
    page.evaluate(WATCH_THE_RETURN)
    page.evaluate("document.querySelector('#lost .btn')?.click()")  # it may be back by itself
    expect(page.locator("#lost")).to_be_empty()
    expect(page.locator("#banner")).not_to_contain_text(re.compile("unknown:|LAST KNOWN"))
    expect(now).to_have_text(re.compile("Safe"))
    assert not page.locator("main").evaluate("(main) => main.inert")
    page.wait_for_timeout(2000)
    seen = page.evaluate("window.seen")
    assert seen
    for tile, banner, chips in seen:
        # The service may say for a second that it has not heard of the twin yet; the page is whole.
        assert not re.search("does not answer|loading|no verdict", tile), seen
        assert not re.search("unknown:|LAST KNOWN", banner), seen
        # What is pushed did stop: it comes through the side that was frozen.
        assert "no data" not in re.sub(r"pushno data [\d.]+ s", "", chips), seen


def test_a_frozen_cell_leaves_no_verdict_on_the_page(
    screen: Callable[..., Page], plant: Plant
) -> None:
    """The web side still answers, but what it knows of the machine is old."""
    page = screen(f"operator/{BEARING}")
    now = page.locator('.ans[aria-label="Is it safe now"] .word')
    expect(now).to_have_text(re.compile("Safe"))
    assert plant.service is not None
    with plant.service.frozen("cell"):
        expect(now).to_have_text("Unknown")
    expect(now).to_have_text(re.compile("Safe"))
