"""Charts are read with the pointer, with the keyboard, from afar and on paper."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser.plant import BEARING, Plant
from tests.browser.test_page_quality import axe, violations
from tests.processes import wait_until

pytestmark = pytest.mark.browser

__all__ = ["axe"]  # a fixture

Screen = Callable[..., Page]


def chart(page: Page) -> Any:
    """The temperatures of the operator's page, once there is a past to read."""
    box = page.locator(".p-trend .plot.t")
    expect(box.locator("canvas")).to_be_visible()
    wait_until(
        lambda: page.evaluate("document.querySelector('.p-trend .plot.t canvas').width > 100"),
        60,
        "a chart",
    )
    return box


def read(page: Page, key: str, times: int = 1) -> str:
    for _ in range(times):
        chart(page).press(key)
    return str(page.locator(".p-trend .tip").text_content())


def test_the_cursor_reads_speed_and_load_with_the_temperatures(screen: Screen) -> None:
    page = screen(f"operator/{BEARING}")
    box = chart(page)
    tip = page.locator(".p-trend .tip")
    width = box.evaluate("(box) => box.clientWidth")
    reading = r"Inner ring [\d.]+ °C.*Speed \d+ rpm.*Load \d+ N"

    def sweep() -> bool:
        """Go over the past, of which there is as much as the service is old."""
        for share in range(80, 20, -2):
            box.hover(position={"x": width * share / 100, "y": 60})
            if re.search(reading, tip.inner_text(), re.S):
                return True
        return False

    wait_until(sweep, 60, "a reading of all lanes")


@pytest.mark.thorough
def test_a_chart_is_read_with_the_keyboard(screen: Screen, problems: list[str]) -> None:
    page = screen(f"operator/{BEARING}")
    box = chart(page)
    box.focus()
    wait_until(lambda: "Inner ring" in read(page, "ArrowLeft"), 60, "a first reading")
    first = read(page, "End")
    assert read(page, "ArrowLeft", 2) != first
    # Tests before this one let temperatures jump: what is foreseen from there may be negative.
    marked = r"Inner ring −?[\d.]+ °C.*Δ .*0\.0 K.*\D0 s after the mark"
    # Where new values come between the key and the look, the chart has moved on below the cursor.
    wait_until(lambda: re.search(marked, read(page, "Enter")), 60, "a reading at the mark")
    assert "before the mark" in read(page, "Home")
    assert page.locator(".p-trend .tip").is_visible()
    box.press("Escape")
    expect(page.locator(".p-trend .tip")).to_be_hidden()
    assert not problems


@pytest.mark.thorough
def test_history_is_read_with_the_keyboard(screen: Screen) -> None:
    page = screen(f"history/{BEARING}")
    box = page.locator(".p-past .plot.t")
    expect(box.locator("canvas")).to_be_visible()
    tip = page.locator(".p-past .plot.t .tip")

    def read_once() -> bool:
        box.press("End")
        return tip.is_visible() and "Inner ring" in tip.inner_text()

    wait_until(read_once, 60, "a reading")


THICKNESS = """(canvas) => {
  const { width, height } = canvas;
  const copy = new OffscreenCanvas(width, height).getContext('2d', { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  // The line of now is the only thing that is ink from top to bottom.
  const { data } = copy.getImageData(0, 0, width, height);
  const ink = (x, y) => data[4 * (y * width + x)] > 200 && data[4 * (y * width + x) + 3] > 200;
  let columns = 0;
  for (let x = 0; x < width; x += 1) {
    let count = 0;
    for (let y = 0; y < height; y += 1) count += ink(x, y);
    columns += count > height * 0.6;
  }
  return columns;
}"""


@pytest.mark.thorough
def test_lines_grow_with_the_wall(browser: Browser, plant: Plant) -> None:
    def columns(width: int, height: int) -> int:
        context = browser.new_context(viewport={"width": width, "height": height})
        page = context.new_page()
        page.goto(f"{plant.address}/#key={plant.key}")
        page.goto(f"{plant.address}/#operator/{BEARING}")
        canvas = chart(page).locator("canvas")
        found: list[int] = []
        wait_until(lambda: found.append(canvas.evaluate(THICKNESS)) or found[-1] > 0, 60, "now")
        context.close()
        return found[-1]

    desk, wall = columns(1440, 900), columns(3840, 2160)
    assert wall >= 2 * desk


@pytest.mark.thorough
def test_no_view_hides_what_scrolls_from_the_keyboard(
    browser: Browser, plant: Plant, axe: str
) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True)
    page = context.new_page()
    page.goto(f"{plant.address}/#key={plant.key}")
    page.locator("nav.tabs a[aria-current]").wait_for()
    page.evaluate(axe)
    found: list[str] = []
    for view in ("engineer", "history", "operator"):
        page.goto(f"{plant.address}/#{view}/{BEARING}")
        expect(page.locator("nav.tabs a[aria-current]")).to_have_text(view.capitalize())
        expect(page.locator("main h1").first).to_be_attached()
        expect(page.locator("#banner")).not_to_be_empty()
        found += violations(page, view)
    context.close()
    assert not found, "\n".join(found)


@pytest.mark.thorough
def test_paper_is_light_and_holds_the_whole_page(screen: Screen, tmp_path: Path) -> None:
    page = screen(f"operator/{BEARING}")
    chart(page)
    page.emulate_media(media="print")
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate("document.documentElement.dataset.theme") == "light"
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    expect(page.locator("nav.tabs")).to_be_hidden()
    expect(page.locator(".ans").first).to_be_visible()
    assert page.evaluate("getComputedStyle(document.querySelector('main')).display") == "block"
    page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    assert len(page.pdf(path=tmp_path / "page.pdf", prefer_css_page_size=True)) > 20_000
