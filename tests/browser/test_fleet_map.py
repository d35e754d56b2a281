"""More machines than cards: what needs attention first, and a map; nothing more is followed."""

import re
from collections.abc import Iterator
from importlib.resources import files

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from tests.browser.plant import FLEET_GROUPS, Fleet
from tests.browser.test_large_fleet import look, overflow
from tests.processes import wait_until

pytestmark = pytest.mark.browser

COUNT = 40
HOT, LOST = 16, 21
MANY = 10_000
PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with Fleet(tmp_path_factory.mktemp("fleet"), COUNT) as fleet:
        fleet.values[fleet.ids[HOT]]["t_inner_ring_c"] = 97.5
        fleet.start()
        wait_until(lambda: fleet.alarm("measured limit", fleet.ids[HOT]), 60, "an alarm")
        yield fleet


def lines(page: Page) -> list[str]:
    """Addresses of all streams that a page opens from now on."""
    opened: list[str] = []
    page.on("websocket", lambda socket: opened.append(socket.url))
    return opened


@pytest.mark.thorough
def test_what_needs_attention_comes_first_and_is_one_click_away(
    context: BrowserContext, fleet: Fleet
) -> None:
    page = look(context, fleet)
    rows = page.locator(".attn a")
    first = rows.first
    expect(first).to_have_attribute("data-asset", fleet.ids[HOT])
    expect(first).to_contain_text("97.5")
    expect(page.locator("#banner")).to_contain_text("over alarm 95")
    counts = page.locator(".fchips button b")
    expect(counts.first).to_have_text("1")  # over a limit
    expect(page.locator(".smap canvas")).to_have_count(len(FLEET_GROUPS))
    told = page.evaluate("fetch('/api/v1/fleet/map').then((answer) => answer.json())")
    assert len(told["marks"]) == COUNT
    assert overflow(page) == {"x": 0, "y": 0}
    opened = lines(page)
    first.click()
    expect(page.locator('.ans[aria-label="Is it safe now"] .word')).to_have_text("Not safe")
    expect(page.locator(".p-trend canvas").first).to_be_visible()
    # Only what is shown is followed, and yet no alarm of another is missed.
    assert [re.search(r"live=([^&]*)", url)[1] for url in opened] == [fleet.ids[HOT]]  # type: ignore[index]
    fleet.silent.add(fleet.ids[LOST])
    wait_until(lambda: fleet.alarm("stale data", fleet.ids[LOST]), 180, "lost data")
    page.get_by_role("link", name="Alarms", exact=True).click()
    expect(page.locator(".p-alist .al").first).to_contain_text("over alarm 95")
    page.get_by_role("link", name="Fleet", exact=True).click()
    lost = page.locator(f'.attn a[data-asset="{fleet.ids[LOST]}"]')
    expect(lost).to_be_visible()
    expect(lost.locator("s")).to_contain_text("42.0")
    assert opened[-1].endswith("live=") or "live=&" in opened[-1]
    fleet.silent.clear()
    expect(lost.locator("s")).to_have_count(0)


@pytest.mark.thorough
def test_a_link_keeps_what_is_chosen(context: BrowserContext, fleet: Fleet) -> None:
    page = look(context, fleet)
    page.get_by_role("button", name=re.compile("over a limit")).click()
    rows = page.locator(".attn a")
    expect(rows).to_have_count(1)
    group = FLEET_GROUPS[HOT % 2]
    page.get_by_label("Group", exact=True).select_option(group)
    page.get_by_label("Search assets").fill(fleet.ids[HOT].upper())
    expect(page).to_have_url(
        re.compile(rf"#fleet\?group={group}&state=over&q={fleet.ids[HOT].upper()}$")
    )
    other = look(context, fleet, page.url.split("#")[1])
    expect(other.locator(".attn a")).to_have_count(1)
    expect(other.locator(".attn a")).to_have_attribute("data-asset", fleet.ids[HOT])
    expect(other.locator(".smap canvas")).to_have_count(1)
    other.get_by_label("Search assets").fill("nothing like it")
    expect(other.get_by_text("No asset fits")).to_be_visible()
    gone = look(context, fleet, f"fleet?group=Hall%209&state=over&q={fleet.ids[HOT]}")
    expect(gone.get_by_label("Group", exact=True)).to_have_value("")
    expect(gone.locator(".attn a")).to_have_attribute("data-asset", fleet.ids[HOT])


@pytest.mark.thorough
def test_the_map_is_used_with_the_keyboard_and_clean(context: BrowserContext, fleet: Fleet) -> None:
    page = look(context, fleet)
    told = page.locator(".p-states p[role=status]")
    page.locator(".smap").focus()
    # The first block by name holds every second machine.
    second = [one for number, one in enumerate(fleet.ids) if number % 2 == 1]
    page.keyboard.press("ArrowRight")
    expect(told).to_contain_text(f"{second[1].capitalize()}, {FLEET_GROUPS[1]}")
    page.evaluate(files("axe_playwright_python").joinpath("axe.min.js").read_text("utf-8"))
    for theme in ("dark", "light"):
        page.evaluate(f"document.documentElement.dataset.theme = '{theme}'")
        tags = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
        found = page.evaluate("(tags) => axe.run(document, { runOnly: tags })", tags)
        assert [(one["id"], one["nodes"][0]["html"]) for one in found["violations"]] == []
    page.locator(".smap").focus()
    page.keyboard.press("Home")
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile(rf"#operator/{second[0]}$"))


@pytest.mark.thorough
def test_a_phone_shows_it_without_scrolling_sideways(browser: Browser, fleet: Fleet) -> None:
    context = browser.new_context(viewport=PHONE, has_touch=True)
    page = look(context, fleet)
    expect(page.locator(".attn a").first).to_have_attribute("data-asset", fleet.ids[HOT])
    expect(page.locator(".smap canvas").first).to_be_attached()
    assert overflow(page)["x"] == 0
    # A finger asks first, and opens with the second touch.
    canvas = page.locator(".smap canvas").first
    canvas.scroll_into_view_if_needed()
    canvas.tap(position={"x": 6, "y": 6})
    expect(page.locator(".stip")).to_be_visible()
    expect(page).to_have_url(re.compile("#fleet$"))
    canvas.tap(position={"x": 6, "y": 6})
    expect(page).to_have_url(re.compile("#operator/"))
    context.close()


@pytest.mark.thorough
def test_old_states_are_called_old(context: BrowserContext, fleet: Fleet) -> None:
    """The web side answers still, but the cell tells it nothing."""
    page = look(context, fleet)
    expect(page.locator(".attn a").first).to_be_visible()
    assert fleet.service is not None
    with fleet.service.frozen("cell"):
        expect(page.get_by_text("States are not current")).to_be_visible()
        expect(page.locator("main")).to_have_class(re.compile("old"))
    expect(page.get_by_text("States are not current")).to_be_hidden()
    expect(page.locator("main")).not_to_have_class(re.compile("old"))


def test_ten_thousand_cells_are_laid_out_and_change_one_by_one(parts: Page) -> None:
    """Each has a place of its own; what has not changed is not drawn again."""
    parts.set_viewport_size({"width": 1920, "height": 1080})
    told = parts.evaluate(
        """async (count) => {
          document.head.innerHTML = '<link rel="stylesheet" href="../css/tokens.css">'
            + '<link rel="stylesheet" href="../css/fleet.css">';
          const { StateMap } = await import('/js/fleet/state_map.js');
          const opened = [];
          const map = new StateMap({ open: (id) => opened.push(id), explain: async () => '' });
          map.element.style.height = '800px';
          map.element.style.overflowY = 'auto';
          document.body.append(map.status, map.element);
          const assets = Array.from({ length: count }, (_, i) => ({ group: `Line ${i % 7}`,
            id: `axle-${i}`, name: `Axle ${i}`, mark: "abdefghij"[i % 9] }));
          map.show(assets);
          await new Promise(requestAnimationFrame);
          let drawn = 0;
          const { paint } = map;
          map.paint = (...given) => { drawn += 1; paint.apply(map, given); };
          map.repaint();
          const again = drawn;
          assets[5].mark = 'A';
          map.repaint();
          const places = new Set(map.blocks.flatMap((block, number) => block.assets.map((_, i) =>
            [number, i % block.columns, Math.floor(i / block.columns)].join())));
          const inside = map.blocks.every(({ canvas, assets: own, columns, ratio }) =>
            canvas.height >= Math.ceil(own.length / columns) * map.cell.height * ratio);
          const wide = Math.max(...map.blocks.map(({ canvas }) => canvas.clientWidth));
          map.press(new KeyboardEvent('keydown', { key: 'End' }));
          map.press(new KeyboardEvent('keydown', { key: 'Enter' }));
          const last = map.blocks.at(-1).assets.at(-1).id;
          return { again, drawn, places: places.size, inside, fits: wide <= map.element.clientWidth,
            elements: map.element.querySelectorAll('*').length, opened, last };
        }""",
        MANY,
    )
    assert (told["again"], told["drawn"], told["places"]) == (0, 1, MANY)
    assert told["inside"]
    assert told["fits"]
    assert told["elements"] < 100
    assert told["opened"] == [told["last"]]
