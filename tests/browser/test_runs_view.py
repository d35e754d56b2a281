"""Runs in the history view: listed, compared over each other, named, annotated, reported."""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, Route, expect

from service.clock import rfc3339
from tests.browser.plant import BEARING, Plant
from tests.browser.test_dashboard_parts import run
from tests.browser.test_page_quality import axe, violations_in_all_sizes
from tests.processes import wait_until

__all__ = ["axe"]  # a fixture

pytestmark = pytest.mark.browser

Screen = Callable[..., Page]
US = 1_000_000
NAME = "cold start <b>$1$</b>"
NOTE = "noise at <i>10:00</i>"


@pytest.fixture(scope="module")
def past(started_plant: Plant) -> int:
    """Two runs of half an hour, long ago, the second warmer; gives the start of the first in µs."""
    start_us = started_plant.clock.now_us() // (60 * US) * 60 * US - 60 * 86_400 * US
    samples = [
        {"channel": channel, "time": rfc3339(start_us + second * US), "value": value}
        for second in range(-600, 6000, 20)
        for run in [0 <= second < 1800 or 3600 <= second < 5400]
        for channel, value in (
            ("speed_rpm", 1500.0 if run else 0.0),
            ("t_inner_ring_c", 20 + (second % 3600) / 180 + (8 if second >= 3600 else 0)),
        )
    ]
    for first in range(0, len(samples), 5000):
        started_plant.push_all(BEARING, samples[first : first + 5000])
    return start_us


def open_runs(page: Page) -> None:
    button = page.get_by_role("button", name="Runs", exact=True)
    expect(button).to_have_attribute("aria-expanded", "false")
    button.press("Enter")
    expect(button).to_have_attribute("aria-expanded", "true")
    expect(page.locator(".p-runs tbody tr").last).to_be_visible()


def test_runs_from_the_list_to_the_report(
    screen: Screen, plant: Plant, past: int, problems: list[str], axe: str
) -> None:
    runs = f"/assets/{BEARING}/runs"

    def the_present_one_runs() -> bool:
        """Whether the machine turns now; a gap of the data, earlier, has made runs of its own."""
        items = plant.get(runs)["items"]
        return len(items) >= 3 and items[0]["ended"] is None

    wait_until(the_present_one_runs, 60, "the present run")
    page = screen(f"history/{BEARING}", role="operator")
    open_runs(page)
    rows = page.locator(".p-runs tbody tr")
    expect(rows.nth(0)).to_contain_text("running")
    first, second = (page.locator(f".p-runs tbody tr:nth-last-child({row})") for row in (1, 2))
    expect(first).to_contain_text("30 min")
    expect(first).to_contain_text("standstill")

    first.get_by_role("checkbox").check()
    second.get_by_role("checkbox").check()
    plot = page.locator(".runs-plot")
    expect(page.locator(".runs-legend li")).to_have_count(2)
    plot.focus()
    plot.press("Home")
    for _ in range(30):
        plot.press("ArrowRight")
    tip = plot.locator(".tip")
    expect(tip).to_contain_text("after the start")
    values = [float(text.split()[-2]) for text in tip.locator("div").all_inner_texts()[1:]]
    assert len(values) == 2, "the values of both runs at the same time after their starts"
    assert values[1] - values[0] == pytest.approx(8.0, abs=0.2)

    first.get_by_role("button", name="Name ").click()
    page.get_by_label("Name (empty: none)").fill(NAME)
    page.get_by_role("button", name="Save", exact=True).click()
    expect(first.locator(".name")).to_have_text(NAME)
    expect(page.locator(".runs-legend li").first).to_contain_text(NAME)

    first.get_by_role("button", name=f"Show {NAME}").press("Enter")
    expect(page.locator(".p-past [role=status]")).to_contain_text("values")
    page.get_by_role("button", name="Note…").click()
    page.get_by_label("Note (everyone can read it)").fill(NOTE)
    page.get_by_role("button", name="Add", exact=True).click()
    expect(page.locator(".notes li")).to_contain_text(NOTE)
    latest = plant.get(runs)["items"][-1]
    assert latest["name"] == NAME
    kept = plant.get(f"{runs}/{latest['id']}")["annotations"]
    assert [one["text"] for one in kept] == [NOTE]

    for format, begin in (("PDF", b"%PDF-"), ("CSV", b"\xef\xbb\xbfRun,item")):
        with page.expect_download() as saved:
            first.get_by_role("button", name=f"Report of {NAME} as {format}").click()
        content = saved.value.path().read_bytes()
        assert content.startswith(begin)
    assert NOTE.encode() in content
    page.evaluate(axe)
    assert violations_in_all_sizes(page, "history") == []
    page.get_by_role("button", name=f"Remove the note {NOTE}").click()
    expect(page.locator(".notes li")).to_have_count(0)
    assert problems == []


@pytest.mark.thorough
def test_a_viewer_reads_and_changes_nothing(screen: Screen, past: int, problems: list[str]) -> None:
    page = screen(f"history/{BEARING}", role="viewer")
    page.set_viewport_size({"width": 390, "height": 800})
    open_runs(page)
    row = page.locator(".p-runs tbody tr").last
    expect(row.get_by_role("button", name="Name ")).to_be_disabled()
    row.get_by_role("button", name="Show ").click()
    expect(page.get_by_role("button", name="Note…")).to_be_disabled()
    wide = page.evaluate("document.documentElement.scrollWidth - innerWidth")
    assert wide <= 0, "nothing is wider than a phone"
    assert problems == []


@pytest.mark.thorough
def test_a_report_that_cannot_be_made_here_says_what_to_install(screen: Screen, past: int) -> None:
    page = screen(f"history/{BEARING}", role="viewer")

    def without_matplotlib(route: Route) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, json=answer.json() | {"report_formats": ["csv"]})

    page.route(re.compile(r"/runs\?"), without_matplotlib)
    open_runs(page)
    row = page.locator(".p-runs tbody tr").last
    for format in ("PDF", "PNG"):
        button = row.get_by_role("button", name=re.compile(f" as {format}$"))
        expect(button).to_be_disabled()
        expect(button).to_have_attribute("title", re.compile(r'pip install "matplotlib>=3.10"$'))
    expect(row.get_by_role("button", name=re.compile(" as CSV$"))).to_be_enabled()


def test_what_is_refused_is_said_once(parts: Page) -> None:
    """The detail of a problem often has its errors in it."""
    problem = {
        "detail": "format: pdf needs matplotlib; expected csv",
        "errors": [{"parameter": "format", "detail": "pdf needs matplotlib; expected csv"}],
    }
    other = {"title": "Unprocessable", "errors": [{"detail": "id: too long"}]}
    answers = iter((problem, other))
    parts.route(
        "**/api/v1/x",
        lambda route: route.fulfill(
            status=422, content_type="application/problem+json", json=next(answers)
        ),
    )
    call = "const { call } = await import('/js/app/api.js');"
    for wanted in (problem["detail"], "Unprocessable: id: too long"):
        assert run(parts, call + "return call('/x').catch((error) => error.message);") == wanted
