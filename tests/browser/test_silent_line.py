"""A stream that falls silent without an end: the page says so within seconds, with its age."""

import re
from collections.abc import Iterator
from typing import NamedTuple
from urllib.parse import urlsplit

import pytest
from patience import patience
from playwright.sync_api import BrowserContext, Page, expect

from tests.browser.line import Line, running_line
from tests.browser.plant import BEARING, Plant

pytestmark = pytest.mark.browser

#: Milliseconds in which the page must have seen it, with a wide margin for a busy machine.
SOON = 20_000
NOW = '.ans[aria-label="Is it safe now"] .word'
#: The machine sleeps: its clock goes on, and what counts how long the browser runs stands still.
SLEEP = "(ms) => { const { now } = Date; Date.now = () => now() + ms; }"
#: The service has another page from now on; a mark shows whether this one is still the same.
UPDATED = """() => {
  const { fetch } = window;
  const version = 'f'.repeat(16);
  window.before = true;
  window.fetch = async (path, options) => (path === '/'
    ? new Response(`<html data-version="${version}">`) : fetch(path, options));
}"""
#: Titles of the strip of lost data from now on.
SEEN = """() => {
  window.seen = [];
  const box = document.querySelector('#lost');
  new MutationObserver(() => window.seen.push(box.querySelector('b')?.textContent))
    .observe(box, { childList: true, subtree: true, characterData: true });
}"""
SAFE = re.compile("Safe")
LOST = "Connection lost"


class Screen(NamedTuple):
    page: Page
    line: Line


@pytest.fixture
def screen(plant: Plant, context: BrowserContext) -> Iterator[Screen]:
    """The operator's view over a line that can be held."""
    parts = urlsplit(plant.address)
    with running_line(parts.hostname or "", parts.port or 0) as line:
        page = context.new_page()
        page.goto(f"{line.address}/#key={plant.key_of('viewer')}")
        page.locator("nav.tabs a[aria-current]").wait_for()
        page.goto(f"{line.address}/#operator/{BEARING}")
        expect(page.locator(NOW)).to_have_text(SAFE)
        yield Screen(page, line)
        page.close()


def age_s(page: Page) -> float:
    """Seconds of the age that the strip of lost data shows."""
    text = page.locator("#lost").inner_text().replace("\u00a0", " ")
    found = re.search(r"for (?:(\d+) min )?([\d.]+) s", text)
    assert found, text
    return 60 * int(found[1] or 0) + float(found[2])


def lose_and_return(page: Page, line: Line) -> None:
    """Hold the line: the page says that it is lost, for however short a time, and is back."""
    page.evaluate(SEEN)
    line.hold(new_ones=False)
    page.wait_for_function(f"() => window.seen.includes('{LOST}')", timeout=patience(SOON))
    expect(page.locator("#lost")).to_be_empty(timeout=patience(SOON))


def test_a_stream_that_falls_silent_is_no_live_page(screen: Screen) -> None:
    """REST still answers, and nothing is closed."""
    page, line = screen
    line.hold(new_ones=True)
    held_ms = page.evaluate("Date.now()")
    expect(page.locator("#lost")).to_contain_text(LOST, timeout=patience(SOON))
    expect(page.locator(NOW)).to_have_text("Unknown")
    expect(page.locator("#banner")).to_contain_text(re.compile("Alarms unknown|LAST KNOWN"))
    # All ages count from the last message, which came a moment before.
    since_s = (page.evaluate("Date.now()") - held_ms) / 1000
    assert since_s - 2 < age_s(page) < since_s + 3
    assert since_s < 12
    expect(page.locator(".clock")).to_have_text(re.compile(r"\d+ s old"))
    shown = page.locator("#lost time").get_attribute("title")
    line.hold(new_ones=False)
    page.locator("#lost").get_by_role("button", name="Retry now").click()
    expect(page.locator("#lost")).to_be_empty(timeout=patience(SOON))
    expect(page.locator(NOW)).to_have_text(SAFE)
    assert shown


def test_a_dead_line_beside_a_live_one_is_opened_again(screen: Screen) -> None:
    page, line = screen
    opened = line.opened
    lose_and_return(page, line)
    expect(page.locator(NOW)).to_have_text(SAFE)
    assert line.opened == opened + 1


def test_after_a_sleep_the_values_before_it_are_not_current(screen: Screen) -> None:
    page, line = screen
    line.hold(new_ones=True)
    page.evaluate(SLEEP, 600_000)
    # The verdict is 10 minutes old in the same moment, before the line is looked at.
    expect(page.locator(NOW)).to_have_text("Unknown", timeout=patience(2_000))
    expect(page.locator("#lost")).to_contain_text(LOST, timeout=patience(3_000))
    assert age_s(page) >= 600
    expect(page.locator(".clock")).to_have_text(re.compile("10 min .* old"))


def test_a_page_of_the_version_before_loads_again(screen: Screen) -> None:
    """The service is updated while a display on a wall shows it."""
    page, line = screen
    page.evaluate(UPDATED)
    line.hold(new_ones=False)
    page.wait_for_function("() => window.before === undefined", timeout=patience(60_000))
    expect(page.locator(NOW)).to_have_text(SAFE)
    assert page.url.endswith(f"#operator/{BEARING}")


def test_a_page_with_input_loads_again_when_its_user_leaves_the_view(screen: Screen) -> None:
    page, line = screen
    page.goto(f"{line.address}/#alarms/{BEARING}")
    expect(page.locator("nav.tabs a[aria-current]")).to_have_text("Alarms")
    page.evaluate(UPDATED)
    line.hold(new_ones=False)
    expect(page.get_by_role("button", name="Load new version")).to_be_visible()
    assert page.evaluate("window.before")
    page.locator("nav.tabs a", has_text="History").click()
    page.wait_for_function("() => window.before === undefined")
    expect(page.locator("nav.tabs a[aria-current]")).to_have_text("History")
    expect(page.get_by_role("button", name="Load new version")).to_have_count(0)
    # What stands between and keeps the old page must not have it load again and again.
    page.evaluate(UPDATED)
    lose_and_return(page, line)
    page.wait_for_timeout(1_000)
    expect(page.get_by_role("button", name="Load new version")).to_have_count(0)


@pytest.mark.parametrize(
    "event",
    [
        "document.dispatchEvent(new Event('visibilitychange'))",
        "dispatchEvent(new PageTransitionEvent('pageshow', { persisted: true }))",
        "dispatchEvent(new Event('online'))",
    ],
)
def test_a_page_that_is_looked_at_again_asks_for_another_line_at_once(
    screen: Screen, event: str
) -> None:
    page, line = screen
    page.evaluate(event)  # a line that has just been heard is left alone
    opened = line.opened
    line.hold(new_ones=False)
    page.wait_for_timeout(3_500)
    assert line.opened == opened
    page.evaluate(event)
    page.wait_for_function("() => document.querySelector('#lost').textContent === ''")
    expect(page.locator(NOW)).to_have_text(SAFE)
    assert line.opened == opened + 1


def test_a_page_that_waits_to_try_again_tries_when_it_is_looked_at(
    screen: Screen,
) -> None:
    page, line = screen
    line.hold(new_ones=True)
    expect(page.locator("#lost")).to_contain_text("next try in", timeout=patience(60_000))
    line.hold(new_ones=False)
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
    expect(page.locator("#lost")).to_be_empty(timeout=patience(SOON))
