"""Several machines at a glance, and one with a network of its own."""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.browser.plant import BEARING, GEARBOX, Plant

pytestmark = pytest.mark.browser

Screen = Callable[..., Page]


def test_the_worst_machine_comes_first(screen: Screen, plant: Plant, problems: list[str]) -> None:
    page = screen("fleet")
    cards = page.locator(".card")
    expect(cards).to_have_count(2)
    bearing, gearbox = (page.locator(".card", has_text=name) for name in (BEARING, GEARBOX))
    expect(bearing.locator(".word")).to_have_text("Safe")
    plant.values[GEARBOX]["t_bearing_c"] = 90.0
    expect(gearbox.locator(".word")).to_have_text("Not safe")
    expect(gearbox.locator(".l")).to_have_text("over warning 85\u00a0°C")
    expect(cards.first).to_contain_text(GEARBOX)
    plant.calm()
    plant.silent.add(BEARING)
    expect(bearing.locator(".word")).to_have_text("Unknown")
    expect(bearing).to_have_class(re.compile("bad"))
    expect(bearing.locator(".fig")).to_have_css("text-decoration-line", "line-through")
    expect(page.locator(".fchips button", has_text="without data").locator("b")).to_have_text("1")
    plant.calm()
    expect(bearing.locator(".word")).not_to_have_text("Unknown")
    assert problems == []


@pytest.mark.thorough
def test_a_card_leads_to_its_machine_and_its_own_nodes(screen: Screen, problems: list[str]) -> None:
    page = screen("fleet")
    page.locator(".card", has_text=GEARBOX).click()
    expect(page.get_by_label("Asset", exact=True)).to_have_value(GEARBOX)
    expect(page.locator(".p-sect h2")).to_have_text("Network gearbox, °C")
    expect(page.locator('[data-figure="t_bearing_c"]')).to_have_text(re.compile(r"\d"))
    expect(page.locator('[data-figure="t_oil_c"]')).to_have_text(re.compile(r"\d"))
    expect(page.locator(".ntiles li", has_text="Oil")).to_contain_text("estimated")
    page.get_by_label("Asset", exact=True).select_option(BEARING)
    expect(page.locator("svg.sect")).to_be_visible()
    assert page.url.endswith(f"#operator/{BEARING}")
    assert problems == []
    page.reload()  # which breaks off whatever is under way, and the browser says so
    expect(page.get_by_label("Asset", exact=True)).to_have_value(BEARING)
