"""What the page makes of a step that cools, and of an estimate that is not well known."""

import pytest
from playwright.sync_api import Page

from tests.browser.test_dashboard_parts import FORECAST, run

pytestmark = pytest.mark.browser

COOLING = (
    FORECAST + "const f = await import('/js/forecast.js');"
    "const { nextStepTile } = await import('/js/tiles.js');"
    "const { judgeProfile } = await import('/js/verdict.js');"
    "const spread = { q025: -4, q25: -1, q50: 0, q75: 1, q975: 4 };"
    "for (const [name, by] of Object.entries(spread))"
    "  forecast.nodes.t_inner_ring_c[name] = medians.map((v) => v + by);"
    "const nowMs = 1200e3;"
    "const fan = f.fanFrom(forecast, nowMs, ['t_inner_ring_c']);"
    "const known = f.fanFrom(forecast, 0, ['t_inner_ring_c']);"
    "const verdict = { next_step: { word, limit: { channel: 't_inner_ring_c', level: 'warning',"
    "  value_c: 90 }, probability: 0.9, alarm_probability: 0.1, reasons: [] } };"
    "const steps = f.distinctSteps(f.stepsFrom(forecast, 0));"
    "const tile = nextStepTile({ nowMs: 0, alone: false, planned: true, steps, limits, verdict,"
    "  fan: known, missing: [], lostChannels: [] });"
    "return [judgeProfile({ forecast, fan, limits, nowMs }), tile.textContent, tile.className];"
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
        "const { Section } = await import('/js/section.js');"
        "const box = document.createElement('div');"
        "const nodes = { 1: 31.74, 3: 32.42, 4: 48.8 };"
        "const measured = { 4: { value: 48.81, usable: true } };"
        "const spreads = { 1: 0.52, 3: 9.4, 4: 9.4 };"
        "new Section(box).update({ nodes, spreads, unknown: [], measured,"
        "  alerts: {}, stale: false });"
        "return [1, 3, 4, 7].map((n) => box.querySelector(`[data-figure='${n}']`).textContent);",
    )
    assert figures == ["31.7", "32 ±18", "48.8", "–"]
