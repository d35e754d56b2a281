"""What everybody may ask of the page: light, quick, readable, usable by keyboard."""

import gzip
import json
import re
from collections.abc import Callable
from importlib.resources import files
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from service.web.pages import static_directory
from service.web.pages.packing import packed_files
from tests.browser.plant import BEARING, GEARBOX, Plant
from tests.processes import wait_until

pytestmark = pytest.mark.browser

Screen = Callable[..., Page]
MOST_BYTES = 200_000
MOST_REQUESTS = 40
MOST_BYTES_OF_ALL = 290_000
PACKED = [path for path in packed_files(static_directory()) if path.endswith(".js")]
VIEWS = (
    "fleet",
    f"operator/{BEARING}",
    f"operator/{GEARBOX}",
    f"whatif/{BEARING}",
    f"envelope/{BEARING}",
    f"engineer/{BEARING}",
    f"history/{BEARING}",
    f"accuracy/{BEARING}",
    "alarms",
    "assets",
)


def test_the_first_view_is_light(browser: Browser, plant: Plant) -> None:
    """All that the operator's view fetches with an empty cache, data included, as it is sent."""
    with browser.new_context() as first:
        page = first.new_page()
        page.goto(f"{plant.address}/#key={plant.key}")
        page.locator("nav.tabs a[aria-current]").wait_for()
        session = first.storage_state()
    sizes: list[tuple[int, str]] = []
    with browser.new_context(storage_state=session) as context:
        # What other views need is fetched 3 s later: not counted here.
        context.add_init_script(
            "const later = window.setTimeout;"
            "window.setTimeout = (act, ms, ...more) => (ms === 3000 ? 0 : later(act, ms, ...more));"
        )
        page = context.new_page()
        page.on(
            "requestfinished",
            lambda request: sizes.append((request.sizes()["responseBodySize"], request.url)),
        )
        page.goto(f"{plant.address}/#operator/{BEARING}")
        expect(page.locator(".p-trend canvas").first).to_be_visible()
        page.wait_for_timeout(1000)
    assert 10 < len(sizes) <= MOST_REQUESTS, json.dumps(sizes, indent=1)
    assert sum(size for size, _ in sizes) < MOST_BYTES, json.dumps(sizes, indent=1)


def test_all_files_of_the_page_are_below_290_kb() -> None:
    packed = sum(
        len(gzip.compress(file.read_bytes()))
        for file in static_directory().rglob("*.*")
        if file.suffix in (".js", ".css", ".html", ".woff2", ".svg")
    )
    assert packed < MOST_BYTES_OF_ALL


def test_a_module_is_in_the_browser_once(screen: Screen, plant: Plant, problems: list[str]) -> None:
    """A view that is fetched later shares the modules of the first view, and their state."""
    page = screen(f"whatif/{BEARING}")
    page.locator("main h1, main .panel").first.wait_for()
    different = page.evaluate(
        """async (paths) => {
          const app = await import('/js/app.js');
          const names = [];
          for (const path of paths) {
            const module = await import('/' + path);
            names.push(...Object.keys(module).filter((name) => module[name] !== app[name]));
          }
          return names;
        }""",
        PACKED,
    )
    assert different == []
    assert problems == []


def test_no_name_of_the_page_hides_one_of_the_browser(parts: Page) -> None:
    """The modules of the first view see each other's names: `history` must stay the browser's.

    An exported name may be one of the browser's, as `find`: who means it has imported it.
    """
    script = packed_files(static_directory())["js/app.js"]
    declared = re.findall(
        r"^(?:(?:async )?function\*?|class|const|let|var) (\w+)", script, re.MULTILINE
    )
    exported = re.findall(r"\w+", script[script.rindex("export {") :])
    private = sorted({*declared} - {*exported})
    assert len(private) > 100
    assert parts.evaluate("(names) => names.filter((name) => name in window)", private) == []


@pytest.fixture(scope="module")
def axe() -> str:
    return files("axe_playwright_python").joinpath("axe.min.js").read_text(encoding="utf-8")


ROUNDS = 3
SIZES = ((390, 844), (768, 1024), (1280, 800), (1920, 1080))
WHOLE = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]


def violations(page: Page, view: str) -> list[str]:
    """What axe-core finds against WCAG 2.2 AA and best practice; contrast in both themes."""
    found: list[dict[str, Any]] = page.evaluate(
        """async (tags) => {
          document.documentElement.dataset.theme = 'dark';
          // A name holds the words that are seen: voice control presses what is read (WCAG 2.5.3).
          const all = await axe.run(document,
            { runOnly: tags, rules: { 'label-content-name-mismatch': { enabled: true } } });
          document.documentElement.dataset.theme = 'light';
          const light = await axe.run(document,
            { runOnly: { type: 'rule', values: ['color-contrast'] } });
          document.documentElement.dataset.theme = 'dark';
          return [...all.violations, ...light.violations];
        }""",
        WHOLE,
    )
    return [
        f"{view}: {one['id']} {node['target']} {node.get('failureSummary', '')}"
        for one in found
        for node in one["nodes"]
    ]


def violations_in_all_sizes(page: Page, view: str) -> list[str]:
    """As `violations`, on a telephone, a tablet, a notebook and a wall screen."""
    before = page.viewport_size
    found: list[str] = []
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        page.evaluate(
            "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )
        found += violations(page, f"{view} at {width} px")
    if before is not None:
        page.set_viewport_size(before)
    return found


def test_words_of_every_priority_are_read_on_their_tint(parts: Page, axe: str) -> None:
    """In both themes, on the page and on a panel, whatever alarm a view shows."""
    parts.evaluate(
        """() => {
          document.head.innerHTML = '<link rel="stylesheet" href="../css/tokens.css">';
          document.documentElement.lang = 'en';
          document.title = 'tints';
          document.body.innerHTML = ['--bg', '--panel'].map((ground) =>
            `<div style="background: var(${ground})">` + ['p1', 'p2', 'p3', 'bad'].map((tint) =>
              `<p style="background: var(--${tint}-tint); color: var(--${tint}-text)">` +
              `${tint} on ${ground}</p>`).join('') + '</div>').join('');
        }"""
    )
    parts.wait_for_function(
        "getComputedStyle(document.documentElement).getPropertyValue('--p1-text') !== ''"
    )
    parts.evaluate(axe)
    found = [one for one in violations(parts, "tints") if "color-contrast" in one]
    assert not found, "\n".join(found)


@pytest.mark.thorough
def test_every_view_meets_wcag_aa(screen: Screen, plant: Plant, axe: str) -> None:
    plant.values[BEARING]["t_inner_ring_c"] = 81.0  # an alarm is on the page
    wait_until(lambda: plant.alarm("measured limit"), 60, "an alarm")
    page = screen("fleet")
    page.evaluate(axe)
    found: list[str] = []
    for view in VIEWS:
        page.goto(f"{plant.address}/#{view}")
        title = view.split("/")[0].capitalize().replace("Whatif", "What-if")
        expect(page.locator("nav.tabs a[aria-current]")).to_have_text(title)
        expect(page.locator("main h1, main .card").first).to_be_attached()
        page.wait_for_timeout(500)
        found += violations_in_all_sizes(page, view)
    plant.silent.update((BEARING, GEARBOX))
    page.goto(f"{plant.address}/#operator/{BEARING}")
    expect(page.locator("#lost")).to_contain_text("No temperature")
    found += violations_in_all_sizes(page, "without data")
    page.goto(f"{plant.address}/#alarms")
    page.get_by_role("button", name=re.compile("^More on")).first.click()
    expect(page.get_by_role("dialog")).to_be_visible()
    found += violations_in_all_sizes(page, "dialog")
    assert not found, "\n".join(found)


# Without figures and times: they change while Tab goes round.
NAME_OF = r"""(at) => [at.tagName, at.type ?? '', at.ariaLabel ?? '', at.getAttribute('href') ?? '',
  at.name ?? '', at.id, at.textContent.trim().slice(0, 60)].join(' ')
  .replace(/\d+[.:]\d+/g, '…')"""
#: What can be used on a page, and what looks as if it could.
USABLE = f"""() => {{
  const name = {NAME_OF};
  const usable = 'a[href], button, input, select, textarea, summary, [tabindex]';
  const shown = (at) =>
    at.checkVisibility({{ visibilityProperty: true }}) && !at.closest('[inert]');
  const reachable = [...document.querySelectorAll(usable)].filter((at) =>
    shown(at) && !at.disabled && at.tabIndex >= 0 && !(at.type === 'radio' && !at.checked));
  const pressable = [...document.body.querySelectorAll('*')].filter((at) =>
    shown(at) && getComputedStyle(at).cursor === 'pointer' &&
    !at.closest(usable + ', label, svg, option'));
  return [reachable.map(name), pressable.map(name)];
}}"""


def tab_through(page: Page) -> dict[str, bool]:
    """Press Tab until it has gone round: what it comes to, and whether a ring shows it."""
    page.evaluate("document.activeElement.blur()")
    reached: dict[str, bool] = {}
    for _ in range(400):
        page.keyboard.press("Tab")
        told = page.evaluate(
            f"""() => {{
              const at = document.activeElement, look = getComputedStyle(at);
              return at === document.body ? null :
                [({NAME_OF})(at), look.outlineStyle, parseFloat(look.outlineWidth)];
            }}"""
        )
        if told is None:
            break
        name, style, width = told
        reached[name] = style != "none" and width >= 2
    return reached


@pytest.mark.thorough
def test_every_view_is_used_by_keyboard(screen: Screen, plant: Plant) -> None:
    """Tab comes to all that can be pressed or filled in, with a ring that shows where it is."""
    page = screen("fleet", "admin")
    found: list[str] = []
    for view in (*VIEWS, "commissioning"):
        page.goto(f"{plant.address}/#{view}")
        expect(page.locator("body")).to_have_attribute("data-view", view.split("/")[0])
        expect(page.locator("main h1, main .card").first).to_be_attached()
        page.wait_for_timeout(500)
        reached: set[str] = set()
        missed: list[str] = []
        for _ in range(ROUNDS):  # a live view may change while Tab goes round
            walk = tab_through(page)
            reached |= walk.keys()
            reachable, pressable = page.evaluate(USABLE)
            assert len(reachable) > 5
            missed = [name for name in reachable if name not in reached]
            if not missed:
                break
        found += [f"{view}: no focus ring on {name}" for name, ring in walk.items() if not ring]
        found += [f"{view}: not reached: {name}" for name in missed]
        found += [f"{view}: for the mouse alone: {name}" for name in pressable]
    assert not found, "\n".join(found)


@pytest.mark.thorough
def test_motion_stops_where_it_is_not_wanted(screen: Screen, plant: Plant) -> None:
    plant.values[BEARING]["t_inner_ring_c"] = 81.0
    page = screen(f"operator/{BEARING}")
    page.emulate_media(reduced_motion="reduce")
    blinking = page.locator("#banner .blink")
    expect(blinking).to_be_visible()
    expect(blinking).to_have_css("animation-name", "none")


@pytest.mark.thorough
def test_targets_are_large_enough_for_a_finger(screen: Screen, plant: Plant) -> None:
    """Check boxes and links of tables: 24 px (WCAG 2.5.8); names of tabs do not touch."""
    page = screen("alarms")
    small: list[str] = []
    for view in (f"history/{BEARING}", "alarms", "assets"):
        page.goto(f"{plant.address}/#{view}")
        expect(page.locator("body")).to_have_attribute("data-view", view.split("/")[0])
        expect(page.locator("main :is(input[type=checkbox], td a)").first).to_be_visible()
        small += page.evaluate(
            """(view) => [...document.querySelectorAll('main :is(input[type=checkbox], td a)')]
              .filter((at) => at.checkVisibility())
              .map((at) => [at, at.getBoundingClientRect()])
              .filter(([, box]) => box.width < 24 || box.height < 24)
              .map(([at, { width, height }]) =>
                [view, at.outerHTML.slice(0, 80), width, height].join(' '))""",
            view,
        )
    assert small == []


@pytest.mark.thorough
def test_names_of_tabs_do_not_touch_on_a_phone(screen: Screen) -> None:
    page = screen(f"operator/{BEARING}")
    page.set_viewport_size({"width": 390, "height": 844})
    gaps = page.evaluate(
        """() => {
          const boxes = [...document.querySelectorAll('nav.tabs a')].map((tab) => {
            const range = document.createRange();
            range.selectNodeContents(tab);
            return range.getBoundingClientRect();
          });
          const lines = Map.groupBy(boxes, (box) => Math.round(box.top));
          return [...lines.values()].flatMap((line) => line.slice(1)
            .map((box, i) => box.left - line[i].right));
        }"""
    )
    assert len(gaps) >= 7
    assert min(gaps) >= 6
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
