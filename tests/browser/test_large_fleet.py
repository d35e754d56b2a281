"""Twenty-five machines: what is worst comes first, and all are seen at once."""

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from tests.browser.conftest import WAIT_MS
from tests.browser.plant import FLEET_GROUPS, LONG_NAME, Fleet
from tests.processes import wait_until

pytestmark = [pytest.mark.browser, pytest.mark.endurance]

COUNT = 25
#: The machine that exceeds a limit; in all tests the same, as its alarm stays for a minute.
OVER = 16
WALL = {"width": 1920, "height": 1080}
PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with Fleet(tmp_path_factory.mktemp("fleet"), COUNT) as fleet:
        fleet.start()
        yield fleet


@pytest.fixture
def wall(browser: Browser) -> Iterator[BrowserContext]:
    context = browser.new_context(viewport=WALL, locale="en-GB", timezone_id="Europe/Berlin")
    yield context
    context.close()


def look(context: BrowserContext, fleet: Fleet, view: str = "fleet") -> Page:
    page = context.new_page()
    page.set_default_timeout(WAIT_MS)
    page.goto(f"{fleet.address}/#key={fleet.key}")
    page.locator("nav.tabs a[aria-current]").wait_for()
    page.goto(f"{fleet.address}/#{view}")
    return page


def overflow(page: Page) -> dict[str, int]:
    """How much larger the page is than its window."""
    larger: dict[str, int] = page.evaluate(
        """() => {
          const { scrollWidth, scrollHeight, clientWidth, clientHeight } = document.documentElement;
          return { x: scrollWidth - clientWidth, y: scrollHeight - clientHeight };
        }"""
    )
    return larger


def test_a_wall_shows_twenty_five_machines_without_scrolling(
    wall: BrowserContext, fleet: Fleet
) -> None:
    page = look(wall, fleet)
    cards = page.locator(".card")
    expect(cards).to_have_count(COUNT)
    expect(page.locator(".card .spark .past")).to_have_count(COUNT)
    assert overflow(page) == {"x": 0, "y": 0}
    boxes = [card.bounding_box() for card in cards.all()]
    assert len({round(box["y"]) for box in boxes if box}) == 5
    assert all(box and box["height"] >= 7 * 16 and box["width"] >= 12 * 16 for box in boxes)
    page.set_viewport_size({"width": 820, "height": 1180})
    assert overflow(page)["x"] == 0


def test_chips_and_groups_choose_which_machines_are_shown(
    wall: BrowserContext, fleet: Fleet
) -> None:
    page = look(wall, fleet)
    cards = page.locator(".card")
    expect(cards).to_have_count(COUNT)
    over = page.locator(".fchips button", has_text="over a limit")
    expect(over.locator("b")).to_have_text("0")
    fleet.values[fleet.ids[OVER]]["t_inner_ring_c"] = 80.0
    expect(over.locator("b")).to_have_text("1")
    over.click()
    expect(cards).to_have_count(1)
    expect(cards.first).to_have_attribute("data-asset", fleet.ids[OVER])
    over.click()
    page.get_by_label("Group", exact=True).select_option(FLEET_GROUPS[1])
    expect(cards).to_have_count(COUNT // 2)
    fleet.calm()


def test_an_alarm_that_stands_comes_first_though_data_are_lost(
    wall: BrowserContext, fleet: Fleet
) -> None:
    hot = fleet.ids[OVER]
    fleet.values[hot]["t_inner_ring_c"] = 97.5

    def over() -> bool:
        alarms = fleet.get("/alarms", asset=hot)["items"]
        return any(alarm["kind"] == "measured limit" and alarm["priority"] == 1 for alarm in alarms)

    wait_until(over, 60, "an alarm over the alarm limit")
    fleet.silent.update(fleet.ids)
    page = look(wall, fleet)
    first = page.locator(".card").first
    expect(first).to_have_attribute("data-asset", hot)
    expect(first.get_by_text("no data")).to_be_attached()
    expect(first).to_have_class(re.compile("p1 solid"))
    expect(first.locator(".word")).to_have_text("Unknown")
    expect(first.locator(".fig")).to_have_css("text-decoration-line", "line-through")
    expect(first.locator(".l")).to_have_text(re.compile("over alarm 95.°C, .* old"))
    counts = page.locator(".fchips button b")
    expect(counts.nth(0)).to_have_text("1")  # over a limit
    expect(counts.nth(2)).to_have_text(str(COUNT))  # without data

    page.goto(f"{fleet.address}/#alarms")
    rows = page.locator(".p-alist .al")
    expect(rows.first).to_contain_text("over alarm 95")
    expect(rows.first).to_have_attribute("data-state", "UNACK")
    states = rows.evaluate_all("(all) => all.map((one) => one.dataset.state)")
    assert states[0] == "UNACK"
    page.get_by_role("button", name=re.compile("^data")).click()
    expect(rows.filter(has_text="over alarm")).to_have_count(0)
    page.get_by_role("button", name=re.compile("^limits")).click()
    expect(rows.filter(has_text="over alarm")).to_have_count(1)
    expect(rows.filter(has_text="No data")).to_have_count(0)

    fleet.calm()
    expect(page.locator("#banner")).to_contain_text(re.compile("over alarm|No active"))
    page.goto(f"{fleet.address}/#fleet")
    expect(page.locator(".card.bad")).to_have_count(0)


def test_a_long_name_never_makes_the_phone_scroll_sideways(browser: Browser, fleet: Fleet) -> None:
    context = browser.new_context(viewport=PHONE, has_touch=True)
    page = look(context, fleet)
    expect(page.get_by_label("Asset", exact=True)).to_have_count(0)  # means nothing in the fleet
    for view in ("fleet", "operator", "history", "envelope", "whatif", "engineer", "alarms"):
        page.goto(f"{fleet.address}/#{view}/{fleet.ids[0]}")
        title = view.capitalize().replace("Whatif", "What-if")
        expect(page.locator("nav.tabs a[aria-current]")).to_have_text(title)
        expect(page.locator("main h1, main .card").first).to_be_attached()
        if view not in ("fleet", "alarms"):  # these show all assets
            chosen = page.get_by_label("Asset", exact=True).locator("option:checked")
            expect(chosen).to_have_text(re.compile(f"^{LONG_NAME}"))
        assert overflow(page)["x"] == 0, view
    context.close()
