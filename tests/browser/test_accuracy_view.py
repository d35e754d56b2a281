"""How good the forecasts were: the view Accuracy, and the operator's line."""

import re
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import BrowserContext, Page, expect

from service.clock import rfc3339
from service.site.settings import load_settings
from service.store import Store
from service.store.forecast_records import IssuedContent, IssuedForecast, Outcome, Settled
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
        store.forecasts.add(issued)
        settled = []
        for one in store.forecasts.since(BEARING, 0):
            if one.issued not in issued:
                continue
            number = issued.index(one.issued)
            value = 45.0 if number % 10 == 0 else 42.5
            states: Any = [["scored", "scored"]] * 3 + [["plan" if number < 6 else "scored"] * 2]
            measured: Any = [
                [value if state == "scored" else None for state in row] for row in states
            ]
            settled.append(Settled(one.id, one.due_us or 0, None, Outcome(states, measured)))
        assert len(store.forecasts.settle(settled)) == 40
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
    # The plant's own forecasts come on top of the 36 of 40 that were inside, at each lead time.
    assert 4 <= count - inside <= 17
    assert count >= 40 * 3 + 34
    detail = page.locator(".a-top .s.mut")
    expect(detail).to_contain_text("6 set aside because the machine did not follow the plan")
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


def test_the_operator_reads_it_in_one_line(screen: Screen, record: Plant) -> None:
    page = screen(f"operator/{BEARING}", "operator")
    line = page.get_by_role("link", name=re.compile("^Forecasts of the last 30 days: "))
    expect(line).to_have_text(re.compile(r"\d+ of \d+ inside the band$"))
    line.click()
    expect(page.locator("nav.tabs a[aria-current]")).to_have_text("Accuracy")


def test_it_fits_a_phone(context: BrowserContext, screen: Screen, record: Plant) -> None:
    page = screen(f"accuracy/{BEARING}")
    page.set_viewport_size({"width": 390, "height": 844})
    expect(page.locator(".a-tab table")).to_be_attached()
    wide = page.evaluate("document.documentElement.scrollWidth - innerWidth")
    assert wide <= 0


def test_scores_of_several_kinds_are_put_together_by_their_readings(parts: Page) -> None:
    found = parts.evaluate(
        """async () => {
          const { together, byLead, chosen, recordText, loses } =
            await import('/js/accuracy.js');
          const naive = (arx) => ({ persistence: { mae_k: 9 }, linear: { mae_k: null },
            arx: { mae_k: arx } });
          const item = (n, more) => ({
            channel: 't_inner_ring_c', lead_time_s: 300, risk: 'low', model_version: 1, n,
            set_aside: 2, set_aside_by: { plan: 1, data: 1, model: 0 }, waiting: 3,
            coverage_50: n ? 0.5 : null, coverage_95: n ? 0.9 : null, bias_k: n ? 1 : null,
            mae_k: n ? 1 : null, crps_k: n ? 1 : null, interval_score_k: n ? 4 : null,
            below: { q025: n ? 0 : null, q25: n ? 0 : null, q50: 0.5, q75: 1, q975: 1 },
            naive: { persistence: { mae_k: 0.5 }, linear: { mae_k: null }, arx: { mae_k: null } },
            ...more,
          });
          const items = [item(30), item(10, { mae_k: 3, lead_time_s: 600, risk: 'high' }), item(0)];
          return {
            all: together(items),
            // Of two versions one has no ARX: the other decides, and there the twin is better.
            leads: byLead([...items,
              item(20, { lead_time_s: 1800, mae_k: 5, naive: naive(null) }),
              item(10, { lead_time_s: 1800, mae_k: 1, naive: naive(2), model_version: 2 })])
              .map((row) => [row.lead, row.n, loses(row)]),
            high: chosen(items, { risk: 'high' }).length,
            texts: [recordText(items), recordText([item(0)]), recordText([]),
              recordText([{ ...item(0), set_aside: 0 }])],
          };
        }"""
    )
    total = found["all"]
    assert (total["n"], total["setAside"], total["waiting"]) == (40, 6, 9)
    assert total["by"] == {"plan": 3, "data": 3, "model": 0}
    assert total["mae_k"] == pytest.approx((30 * 1 + 10 * 3) / 40)
    assert total["naive"] == {"persistence": 0.5, "linear": None, "arx": None}
    assert found["leads"] == [[300, 30, True], [600, 10, True], [1800, 30, False]]
    assert found["high"] == 1
    assert found["texts"] == [
        "Forecasts of the last 30 days: 36 of 40 inside the band",
        "Forecasts of the last 30 days: none scored, 2 set aside",
        "",
        "Forecasts of the last 30 days: none due yet",
    ]


def test_what_is_drawn_is_what_was_kept(parts: Page) -> None:
    made = rfc3339(1_763_700_000_000_000)
    point = {
        "lead_time_s": 600,
        "time": rfc3339(1_763_700_600_000_000),
        "risk": "low",
        "readings": [{"channel": name, "state": "scored", "q50": 42.0} for name in RINGS],
    }
    forecasts = [
        {"made_at": made, "reason": "step", "model_version": 2, "points": [point]},
        {"made_at": made, "reason": "step", "model_version": 2,
         "points": [point | {"time": rfc3339(1_763_700_500_000_000)}]},
    ]  # fmt: skip
    found = parts.evaluate(
        """async ([forecasts, nowMs]) => {
          const { pastPoints } = await import('/js/accuracy.js');
          const times = (lead, now) => pastPoints(forecasts, 't_inner_ring_c', lead, now)
            .map((point) => point.time);
          return [times(600, nowMs), times(600, nowMs - 100000), times(300, nowMs)];
        }""",
        [forecasts, 1_763_700_600_000],
    )
    assert found == [[1_763_700_500_000, 1_763_700_600_000], [1_763_700_500_000], []]
