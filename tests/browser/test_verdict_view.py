"""Whatever is missing: the page never says "Safe" without it, and says what the interface says."""

import random
import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import BrowserContext, Page, Route, expect

from tests.browser.plant import BEARING, GEARBOX, Plant
from tests.browser.test_dashboard import fan_pixels
from tests.processes import wait_until

pytestmark = pytest.mark.browser

Screen = Callable[..., Page]
COMBINATIONS = 100
LABELS = {
    "t_inner_ring_c": "inner ring",
    "t_outer_ring_c": "outer ring",
    "ambient_c": "ambient",
    "speed_rpm": "speed",
    "load_n": "load",
}


@pytest.fixture
def known(plant: Plant) -> Iterator[Plant]:
    """A machine of which everything is known."""
    wait_until(lambda: not verdict(plant)["missing"], 120, "a verdict with all its inputs")
    yield plant
    plant.calm()


def verdict(plant: Plant, asset: str = BEARING) -> Any:
    return plant.get(f"/assets/{asset}/verdict")


def words(page: Page) -> list[str]:
    return page.locator(".ans .word").all_inner_texts()


@pytest.mark.thorough
def test_page_and_interface_agree_whatever_is_missing(
    screen: Screen, known: Plant, problems: list[str]
) -> None:
    page = screen(f"operator/{BEARING}")
    expect(page.locator(".ans .word")).to_have_text(["Safe", "Safe", "Not expected"])
    chance = random.Random(9)
    for number in range(COMBINATIONS):
        # Each input once alone, then any of them, all and none included.
        alone = list(LABELS)[number : number + 1]
        missing = set(alone or chance.sample(list(LABELS), chance.randrange(len(LABELS) + 1)))
        known.bad = missing

        def agreed(missing: set[str] = missing) -> bool:
            told = verdict(known)
            if set(told["missing"]) - {"forecast"} != missing:
                return False
            both = [told[name]["word"].capitalize() for name in ("now", "next_step")]
            if missing:
                assert told["present_step"]["word"] == "unknown"
                assert both == ["Unknown", "Unknown"]
                both.append("Unknown")
            return words(page)[: len(both)] == both

        wait_until(agreed, 60, f"page and interface that agree without {missing}", every_s=0.05)
        if missing:
            assert not any("Safe" in word for word in words(page)), missing
            for name in missing - {"t_inner_ring_c", "t_outer_ring_c"}:
                expect(page.locator("#lost")).to_contain_text(LABELS[name])
    assert problems == []


def test_lost_speed_and_load_are_seen_everywhere(screen: Screen, known: Plant) -> None:
    page = screen(f"operator/{BEARING}")
    expect(page.locator(".conn .src")).to_have_text(re.compile(r"^push"))
    expect(page.locator(".conn .src")).not_to_have_class(re.compile("bad"))
    known.bad = {"speed_rpm", "load_n"}
    expect(page.locator("#lost")).to_contain_text("No speed and load data")
    expect(page.locator(".conn .src")).to_have_text(re.compile("push.*2 lost"))
    tiles = page.locator(".ans")
    for tile in tiles.all():
        expect(tile.locator(".word")).to_have_text("Unknown")
        expect(tile).to_contain_text(re.compile("speed and load lost for"))
    expect(tiles.nth(1).locator("s").first).to_have_text(re.compile("^900.rpm$"))
    speed = page.get_by_role("img", name=re.compile("^Speed measured and planned: lost for "))
    expect(speed).to_be_visible()
    assert "-line-through" not in page.locator(".ans .fig").first.inner_text()
    page.goto(page.url.split("#")[0] + "#fleet")
    card = page.locator(f'.card[data-asset="{BEARING}"]')
    expect(card.locator(".word")).to_have_text("Unknown")
    expect(card.locator("h2 s").first).to_have_text(re.compile("^900.rpm$"))
    page.goto(page.url.split("#")[0] + f"#envelope/{BEARING}")
    expect(page.locator("#probe .word")).to_have_text("Unknown")
    expect(page.locator("#probe")).to_contain_text("speed and load lost")
    expect(page.get_by_role("row", name="now")).to_be_visible()
    expect(page.locator("main")).not_to_contain_text(re.compile("Safe$|Not safe$"))
    expect(page.get_by_role("row").filter(has_text="afe")).to_have_count(0)


@pytest.mark.thorough
def test_a_model_that_was_never_identified_gives_no_next_step(screen: Screen, known: Plant) -> None:
    page = screen(f"operator/{GEARBOX}")
    assert verdict(known, GEARBOX)["missing"] == ["identified model"]
    expect(page.locator(".ans .word")).to_have_text(["Safe", "Unknown", "Unknown"])
    expect(page.locator(".ans").nth(1)).to_contain_text("the model was never identified")
    expect(page.locator("#lost")).to_be_empty()


@pytest.mark.thorough
@pytest.mark.parametrize(("safe", "word"), [(0.0, "Not safe"), (1.0, "Safe")])
def test_one_setting_gives_the_word_in_what_if_and_envelope(
    context: BrowserContext, screen: Screen, known: Plant, safe: float, word: str
) -> None:
    def set_to(route: Route) -> None:
        answer = route.fetch()
        found = answer.json()
        for asset in found.get("items", [found]):
            asset["verdict"]["safe_below_probability"] = safe
        route.fulfill(response=answer, json=found)

    for end in ("", f"/{BEARING}"):
        context.route(f"**/api/v1/assets{end}", set_to)
    page = screen(f"whatif/{BEARING}")
    expect(page.locator(".ans .word").first).to_have_text(word)
    page.goto(page.url.split("#")[0] + f"#envelope/{BEARING}")
    expect(page.locator("#probe .word")).to_have_text(word)
    expect(page.locator(".v-envelope table td.nw").first).to_contain_text(word)


@pytest.mark.thorough
def test_the_band_of_the_whole_run_is_chosen_by_keyboard(
    screen: Screen, known: Plant, problems: list[str]
) -> None:
    page = screen(f"operator/{BEARING}")
    wait_until(lambda: fan_pixels(page) > 2000, 60, "a forecast fan on the canvas")
    keys = page.locator(".p-trend .bandkeys")
    moment, whole = (keys.get_by_role("button", name=name) for name in ("each moment", "whole run"))
    expect(moment).to_have_attribute("aria-pressed", "true")
    before = fan_pixels(page)
    whole.focus()
    whole.press("Enter")
    expect(whole).to_have_attribute("aria-pressed", "true")
    expect(keys).to_contain_text("90 % whole run")
    wait_until(lambda: fan_pixels(page) not in (0, before), 60, "another band")
    page.goto(page.url.split("#")[0] + f"#whatif/{BEARING}")
    expect(page.locator(".p-trend .bandkeys")).to_contain_text("90 % whole run")
    page.get_by_role("button", name="each moment").click()
    expect(page.locator(".p-trend .bandkeys")).not_to_contain_text("90 % whole run")
    assert problems == []
