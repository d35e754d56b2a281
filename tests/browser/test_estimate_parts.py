"""What the page makes of a step that cools, and of an estimate that is not well known."""

import pytest
from playwright.sync_api import Page

from tests.browser.test_dashboard_parts import FORECAST, run

pytestmark = pytest.mark.browser

COOLING = (
    FORECAST + "const f = await import('/js/forecast.js');"
    "const { answerNextStep } = await import('/js/verdict.js');"
    "const { nextStepTile } = await import('/js/tiles.js');"
    "const spread = { q025: -4, q25: -1, q50: 0, q75: 1, q975: 4 };"
    "for (const [name, by] of Object.entries(spread))"
    "  forecast.nodes.t_inner_ring_c[name] = medians.map((v) => v + by);"
    "const fan = f.fanFrom(forecast, 0, ['t_inner_ring_c']);"
    "const steps = f.distinctSteps(f.stepsFrom(forecast, 0));"
    "const answer = answerNextStep({ forecast, fan, steps, limits, nowMs: 0 });"
    "const tile = nextStepTile(answer, { nowMs: 0, alone: false, planned: true });"
    "return [answer, tile.textContent];"
)


def test_a_step_that_only_cools_is_not_taken_for_the_danger(parts: Page) -> None:
    """It begins over the limit, and so is not safe: but it is the way out."""
    answer, text = run(parts, COOLING, medians=[97, 98, 100, 95, 85, 75, 70])
    assert answer["word"] == "unsafe"
    assert answer["cools"]["fromC"] == 100
    assert answer["cools"]["belowMs"] == 2100e3
    assert answer["cools"]["surelyMs"] == 2340e3
    assert "Not safe yet" in text
    assert "15min" in text
    assert "then below 90 °C" in text
    assert "cools from 100.0 °C" in text.replace("\u00a0", " ")


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
    answer, text = run(parts, COOLING, medians=medians)
    assert answer["cools"] is None
    assert "Not safe" in text
    assert "yet" not in text


def test_an_estimate_is_not_said_finer_than_it_is_known(parts: Page) -> None:
    figures = run(
        parts,
        "const { Section } = await import('/js/section.js');"
        "const box = document.createElement('div');"
        "const nodes = { 1: 31.74, 3: 32.42, 4: 48.8 };"
        "const measured = { 4: { value: 48.81, usable: true } };"
        "new Section(box).update({ nodes, spreads: { 1: 0.52, 3: 9.4, 4: 9.4 }, measured,"
        "  alerts: {}, stale: false });"
        "return [1, 3, 4, 7].map((n) => box.querySelector(`[data-figure='${n}']`).textContent);",
    )
    assert figures == ["31.7", "32 ±18", "48.8", "–"]
