"""How good the forecasts were: the view Accuracy, and the operator's line."""

import re
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from playwright.sync_api import BrowserContext, Page, expect
from sqlalchemy import bindparam, update

from service.features.ledger.tables import KeptForecastRow, KeptForecasts
from service.site.settings import load_settings
from service.store import Store
from service.store.forecast_records import IssuedContent, IssuedForecast, Outcome
from tests.browser.plant import BEARING, Plant

pytestmark = pytest.mark.browser

Screen = Callable[..., Page]
MINUTE_US = 60_000_000
RINGS = ["t_inner_ring_c", "t_outer_ring_c"]
LEADS = [300, 600, 1800, 3600]


@pytest.fixture(scope="module")
def record(started_plant: Plant) -> Plant:
    """A past of forecasts: of 40, one in ten was outside, and one hour's plan was not followed."""
    now_us = started_plant.clock.now_us()
    settings = load_settings(started_plant.configuration)
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        issued = []
        for number in range(40):
            content = IssuedContent(
                steps=[(14_400.0, 900.0, 1200.0, 22.0)],
                planned=False,
                labels=[],
                channels=RINGS,
                lead_times_s=LEADS,
                high_risk=[False, False, False, number % 4 == 0],
                quantiles=[[[4000, 4100, 4200, 4300, 4400]] * 2] * 4,
                naive={"persistence": [[4000, 4000]] * 4, "linear": [[4240, 4150]] * 4},
            )
            time_us = now_us - (490 - 10 * number) * MINUTE_US
            issued.append(IssuedForecast(BEARING, time_us, 1, "period", content))
        store.part(KeptForecasts).add(issued)
        rows = []
        for one in store.part(KeptForecasts).since(BEARING, 0):
            if one.issued not in issued:
                continue
            number = issued.index(one.issued)
            value = 45.0 if number % 10 == 0 else 42.5
            states: Any = [["scored", "scored"]] * 3 + [["plan" if number < 6 else "scored"] * 2]
            measured: Any = [
                [value if state == "scored" else None for state in row] for row in states
            ]
            outcome = msgspec.msgpack.encode(Outcome(states, measured))
            rows.append({"of_id": one.id, "what_came": outcome})
        assert len(rows) == 40
        # Written over what the running service, which looks for what is due, has settled meanwhile.
        change = (
            update(KeptForecastRow.__table__)  # type: ignore[arg-type]
            .where(KeptForecastRow.id == bindparam("of_id"))
            .values(outcome=bindparam("what_came"), due_us=None)
        )
        with store._database.writing() as connection:
            connection.execute(change, rows)
    return started_plant


def counts(page: Page) -> tuple[int, int]:
    words = re.search(r"(\d+) of (\d+)", page.locator(".a-top .verdict").inner_text())
    assert words is not None
    return int(words[1]), int(words[2])


def test_the_view_answers_in_words_pictures_and_figures(
    screen: Screen, record: Plant, problems: list[str]
) -> None:
    page = screen(f"accuracy/{BEARING}", "viewer")
    expect(page.locator(".a-top .verdict")).to_contain_text("inside the 95 % band")
    inside, count = counts(page)
    # 36 of 40 were inside at each lead time, the last without the six that were not followed. The
    # plant's own come on top; it jumps as its tests want, so that these may be outside.
    of_record, outside = 40 * 3 + 34, 4 * 3 + 3
    assert outside <= count - inside <= outside + count - of_record
    detail = page.locator(".a-top .s.mut")
    expect(detail).to_contain_text("6 whose plan was not followed to the end")
    for plot in ("rel", "out"):
        expect(page.locator(f".plot.{plot} canvas")).to_be_visible()
        assert page.locator(f".plot.{plot}").get_attribute("aria-label")
    expect(page.locator(".a-out p")).to_contain_text("readings 1 h ahead were inside the 95 % band")
    rows = page.locator(".a-tab tbody tr")
    expect(rows.nth(3).locator("th")).to_have_text("1 h")
    # The linear forecast of the inner ring was better here, and that is said.
    expect(page.locator(".a-tab td.lose").first).to_be_visible()
    expect(page.locator(".a-tab")).to_contain_text("a simple forecast was better")

    page.get_by_role("button", name="High risk").click()
    expect(page.get_by_role("button", name="High risk")).to_have_attribute("aria-pressed", "true")
    expect(rows).to_have_count(1)
    page.get_by_role("button", name="All", exact=True).click()
    page.get_by_role("button", name="10 min", exact=True).press("Enter")
    expect(page.get_by_role("button", name="10 min", exact=True)).to_be_focused()
    expect(page.locator(".a-out p")).to_contain_text("readings 10 min ahead")
    page.get_by_role("button", name="Outer ring").click()
    expect(page.locator(".plot.out")).to_have_attribute("aria-label", re.compile("^Outer ring"))
    assert problems == []


@pytest.mark.thorough
def test_the_operator_reads_it_in_one_line(screen: Screen, record: Plant) -> None:
    page = screen(f"operator/{BEARING}", "operator")
    line = page.get_by_role("link", name=re.compile("^Forecasts of the last 30 days: "))
    expect(line).to_have_text(
        re.compile(r"\d+ of \d+ readings inside the band, \d+ independent runs?$")
    )
    tile = page.get_by_role("region", name="Is the next step safe")
    expect(tile.locator(".record")).to_have_text(
        re.compile(
            r"^record: \d+ of \d+ inside 1 h ahead at (low|high) risk \(\d+ independent runs?\)$"
        )
    )
    line.click()
    expect(page.locator("nav.tabs a[aria-current]")).to_have_text("Accuracy")


@pytest.mark.thorough
def test_it_fits_a_phone(context: BrowserContext, screen: Screen, record: Plant) -> None:
    page = screen(f"accuracy/{BEARING}")
    page.set_viewport_size({"width": 390, "height": 844})
    expect(page.locator(".a-tab table")).to_be_attached()
    wide = page.evaluate("document.documentElement.scrollWidth - innerWidth")
    assert wide <= 0
