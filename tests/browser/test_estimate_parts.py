"""What the page makes of a step that cools, and of an estimate that is not well known."""

import pytest
from playwright.sync_api import Page

from tests.browser.test_dashboard_parts import FORECAST, run

pytestmark = pytest.mark.browser

COOLING = (
    FORECAST + "const f = await import('/js/forecast/forecast.js');"
    "const { nextStepTile } = await import('/js/forecast/tiles.js');"
    "const { nodesOf } = await import('/js/parts/panel.js');"
    "const { judgeProfile } = await import('/js/forecast/verdict.js');"
    "const spread = { q025: -4, q25: -1, q50: 0, q75: 1, q975: 4 };"
    "for (const [name, by] of Object.entries(spread))"
    "  forecast.nodes.t_inner_ring_c[name] = medians.map((v) => v + by);"
    "const nowMs = 1200e3;"
    "const fan = f.fanFrom(forecast, nowMs, ['t_inner_ring_c']);"
    "const known = f.fanFrom(forecast, 0, ['t_inner_ring_c']);"
    "const verdict = { next_step: { word, limit: { channel: 't_inner_ring_c', level: 'warning',"
    "  value_c: 90 }, probability: 0.9, alarm_probability: 0.1, reasons: [] } };"
    "const steps = f.distinctSteps(f.stepsFrom(forecast, 0));"
    "const tile = nodesOf(nextStepTile({ nowMs: 0, alone: false, planned: true, steps, limits,"
    "  verdict, fan: known, missing: [], lostChannels: [] })).firstChild;"
    "const judged = judgeProfile({ forecast, fan, limits, nowMs, safe: 0.05 });"
    "return [judged, tile.textContent, tile.className];"
)


def test_a_step_that_only_cools_is_not_taken_for_the_danger(parts: Page) -> None:
    """It begins over the limit, but it is the way out."""
    medians = [97, 98, 100, 95, 85, 75, 70]
    profile, text, look = run(parts, COOLING, medians=medians, word="recovering")
    assert profile["word"] == "recovering"
    assert profile["cools"]["belowMs"] == 2100e3
    assert profile["cools"]["surelyMs"] == 2340e3
    assert "Recovering" in text
    assert "below 90 °C 15 min into the step (97.5 %: 19 min)" in text.replace("\u00a0", " ")
    assert look.split() == ["ans"], "the remedy is not painted as the threat"


def test_a_step_that_cools_after_an_overrun_ahead_says_both(parts: Page) -> None:
    """Nothing is over its limit yet: no word says that the machine recovers."""
    medians = [97, 98, 100, 95, 85, 75, 70]
    _, text, look = run(parts, COOLING, medians=medians, word="not safe")
    assert "Not safe" in text
    assert "cools down: below 90 °C 15 min into the step" in text.replace("\u00a0", " ")
    assert look.split() == ["ans", "p2"]


@pytest.mark.parametrize(
    "medians",
    [
        [97, 98, 100, 104, 95, 80, 70],  # heats on before it cools
        [97, 98, 100, 97, 95, 93, 91],  # does not get below within the step
        [70, 75, 80, 95, 100, 85, 80],  # what brings the machine over the limit
    ],
)
def test_any_other_step_over_the_limit_is_plainly_not_safe(
    parts: Page, medians: list[float]
) -> None:
    profile, text, look = run(parts, COOLING, medians=medians, word="not safe")
    assert profile["word"] == "not safe"
    assert "Not safe" in text
    assert "Recovering" not in text
    assert "p2" in look


def test_an_estimate_is_not_said_finer_than_it_is_known(parts: Page) -> None:
    figures = run(
        parts,
        "const { Section } = await import('/js/operator/section.js');"
        "const { place } = await import('/js/parts/panel.js');"
        "const box = document.createElement('div');"
        "const nodes = { 1: 31.74, 3: 32.42, 4: 48.8, 8: 37.31 };"
        "const measured = { 4: { value: 48.81, usable: true } };"
        "const spreads = { 1: 0.52, 3: 9.4, 4: 9.4, 8: 0.5 };"
        "place(box, Section, { nodes, spreads, unknown: [], measured,"
        "  alerts: {}, stale: false });"
        "return [1, 3, 4, 7, 8].map((n) => box.querySelector(`[data-figure='${n}']`).textContent);",
    )
    assert figures == ["32 ±1", "32 ±18", "48.8", "–", "37.3"]


def test_ears_hear_no_lost_value_as_a_present_one(parts: Page) -> None:
    said = run(
        parts,
        "const { Section } = await import('/js/operator/section.js');"
        "const { place } = await import('/js/parts/panel.js');"
        "const { spoken } = await import('/js/live/readings.js');"
        "const lost = { value: 1500, usable: false, ageS: 21 };"
        "const box = document.createElement('div');"
        "const measured = { 4: { value: 36.3, usable: true, ageS: 1 }, 2: lost };"
        "place(box, Section, { nodes: {}, spreads: {}, unknown: [], measured, alerts: {},"
        "  stale: false });"
        "return [spoken(lost, 'revolutions per minute'),"
        "  spoken({ ...lost, ageS: null }, 'newtons'),"
        "  spoken({ ...lost, usable: true }, 'newtons'),"
        "  box.querySelector('svg').getAttribute('aria-label')];",
    )
    assert said == [
        "lost for 21 s",
        "no value yet",
        "1500 newtons",
        "Bearing cross-section. Inner ring 36.3 degrees Celsius, outer ring lost for 21 s.",
    ]


def test_a_source_that_was_away_when_the_page_was_opened_has_its_last_value(parts: Page) -> None:
    """Its minute is not among the means yet: the sample itself is asked for."""
    found = run(
        parts,
        """
        const { AssetFeed } = await import('/js/live/feed.js');
        const asked = [];
        window.fetch = async (address) => {
          asked.push(new URL(address, location.href).searchParams.get('end'));
          const items = [{ time: '2026-11-22T08:00:00.000Z', value: 36.3, quality: 192 }];
          return new Response(JSON.stringify({ items, next: null }),
            { headers: { 'Content-Type': 'application/json' } });
        };
        const feed = new AssetFeed('bench-1', { now: () => Date.parse('2026-11-22T08:00:50Z') },
          (request) => request());
        feed.takeSnapshot({ t_inner_ring_c:
          { value: null, quality: 24, time: '2026-11-22T08:00:00.000Z' } });
        feed.history = { channels: ['t_inner_ring_c'], lastMs: () => null };
        await feed.findLastValues();
        return [asked, feed.store.get('tags').t_inner_ring_c.goodValue];""",
    )
    assert found == [["2026-11-22T08:00:00.001Z"], 36.3]
