"""The page shows the service's verdict, whatever else it has at hand."""

from typing import Any

import pytest
from playwright.sync_api import Page

from tests.browser.test_dashboard_parts import run

pytestmark = pytest.mark.browser

INPUTS = ("t_inner_ring_c", "t_outer_ring_c", "ambient_c", "speed_rpm", "load_n")
MISSING = (*INPUTS, "twin", "limits", "identified model", "forecast")

# A live machine, far below its limits, with all that a "Safe" could be made from.
PAGE = """
const { situation } = await import('/js/live/situation.js');
const { liveLimitTile, nextStepTile, nowTile } = await import('/js/forecast/tiles.js');
const { nodesOf } = await import('/js/parts/panel.js');
const { cardVerdict } = await import('/js/fleet/card.js');
const { lostState, sourceChips } = await import('/js/app/frame.js');
const { emptyAsset } = await import('/js/live/store.js');
const nowMs = Date.parse('2026-11-22T08:00:00.000Z');
const clock = { now: () => nowMs, rate: 1 };
const inputs = ['t_inner_ring_c', 't_outer_ring_c', 'ambient_c', 'speed_rpm', 'load_n'];
const good = { t_inner_ring_c: 40, t_outer_ring_c: 35, ambient_c: 22, speed_rpm: 1500,
  load_n: 800 };
const steady = Array(5).fill(40);
const never = { probability: 0, median_s: null, earliest_s: null };
const band = { q025: steady, q25: steady, q50: steady, q75: steady, q975: steady };
const asset = {
  id: 'bench-1', limits: { t_inner_ring_c: { warning: 70, alarm: 95 } },
  active_model: { version: 2, trusted: true, identified },
  channels: inputs.map((name) => ({ name, source: 'push', max_age_s: 120 })),
};
const state = {
  ...emptyAsset(), loaded: true, link: { status: 'live' }, sources: [], asset, verdict: null,
  tags: Object.fromEntries(inputs.map((name) => [name, { value: good[name], quality: 192,
    time: nowMs - age_s * 1000, goodValue: good[name], goodTime: nowMs - age_s * 1000 }])),
  forecast: { made_at: '2026-11-22T08:00:00.000Z', time_s: [0, 900, 1800, 2700, 3600],
    nodes: { t_inner_ring_c: band },
    profile: [{ duration_s: 3600, speed_rpm: 1500, load_n: 800 }],
    time_to_limit: { t_inner_ring_c: { warning: never, alarm: never } } },
};
if (verdict) state.verdict = { ...verdict, heard: {
  wallMs: Date.now(), runningMs: performance.now() - heard_ago_ms } };
const now = situation(state, clock);
const tiles = [nowTile(now, null), nextStepTile(now), liveLimitTile(now)]
  .map((tile) => nodesOf(tile).firstChild);
return {
  fan: now.fan !== null, steps: now.steps.length, why: now.noForecast,
  words: tiles.map((tile) => tile.querySelector('.word').textContent),
  looks: tiles.map((tile) => tile.className),
  texts: tiles.map((tile) => tile.textContent.replaceAll('\\u00a0', ' ')),
  struck: tiles.flatMap((tile) =>
    [...tile.querySelectorAll('s, .st')].map((one) => one.textContent)),
  card: cardVerdict(now, null), strip: lostState(state, clock)?.title ?? null,
  chips: sourceChips(state, clock).map(({ name, up, lost }) => [name, up, lost]),
};
"""


def verdict(
    missing: list[str], now: str, next_step: str, present_step: str | None = None
) -> dict[str, Any]:
    """A verdict as the service sends it."""

    def part(word: str) -> dict[str, Any]:
        limit = {"channel": "t_inner_ring_c", "level": "warning", "value_c": 70}
        known = word != "unknown"
        return {
            "word": word,
            "reasons": [word],
            "limit": limit if known else None,
            "probability": 0.001 if known else None,
            "alarm_probability": 0.0 if known else None,
        }

    return {
        "time": "2026-11-22T08:00:00.000Z",
        "now": part(now),
        "present_step": {
            **part(present_step or next_step),
            "seconds_to_limit": None,
            "ends_at": "2026-11-22T09:00:00.000Z",
        },
        "next_step": part(next_step),
        "time_to_limit": None
        if missing
        else {
            "limit": {"channel": "t_inner_ring_c", "level": "warning", "value_c": 70},
            "expected": False,
            "probability": 0.0,
            "earliest_s": None,
            "median_s": None,
            "horizon_s": 3600,
        },
        "missing": missing,
    }


def shown(
    parts: Page,
    given: Any,
    *,
    age_s: float = 1.0,
    heard_ago_ms: float = 0,
    identified: bool = True,
) -> Any:
    facts = {"age_s": age_s, "heard_ago_ms": heard_ago_ms, "identified": identified}
    return run(parts, PAGE, verdict=given, **facts)


def test_with_every_input_the_three_answers_are_given(parts: Page) -> None:
    page = shown(parts, verdict([], "safe", "safe"))
    assert page["words"] == ["Safe", "Safe", "Not expected"]
    assert page["texts"][2].startswith("Time to warning 70 °C")
    assert page["card"]["word"] == "Safe"
    assert (page["strip"], page["struck"]) == (None, [])
    assert page["chips"] == [["push", True, 0]]


@pytest.mark.parametrize("name", MISSING)
def test_a_missing_input_is_named_and_nothing_is_called_safe(parts: Page, name: str) -> None:
    now = "safe" if name in ("identified model", "forecast") else "unknown"
    page = shown(parts, verdict([name], now, "unknown"), age_s=62)
    assert page["words"] == [now.capitalize(), "Unknown", "Unknown"]
    named = {
        "t_inner_ring_c": "inner ring lost for 1 min 02 s",
        "t_outer_ring_c": "outer ring lost for 1 min 02 s",
        "ambient_c": "ambient lost for 1 min 02 s",
        "speed_rpm": "speed lost for 1 min 02 s",
        "load_n": "load lost for 1 min 02 s",
        "twin": "the twin does not run",
        "limits": "no temperature has a limit",
        "identified model": "the model was never identified",
        "forecast": "there is no recent forecast",
    }[name]
    assert named in page["texts"][1]
    assert named in page["texts"][2]
    if name in INPUTS:
        assert named in page["texts"][0]
        assert page["strip"] is not None
        assert page["chips"] == [["push", True, 1]]
    if name == "speed_rpm":
        assert "1500 rpm" in " ".join(page["struck"]).replace("\u00a0", " ")
    assert page["card"]["word"] == now.capitalize()


def test_a_model_that_was_never_identified_draws_no_fan_and_keeps_the_plan(parts: Page) -> None:
    page = shown(parts, verdict(["identified model"], "safe", "unknown"), identified=False)
    assert (page["fan"], page["why"]) == (False, "the model was never identified")
    assert page["steps"] == 1
    page = shown(parts, verdict([], "safe", "safe"))
    assert (page["fan"], page["why"]) == (True, None)


def test_speed_and_load_lost_together_are_one_line_and_one_strip(parts: Page) -> None:
    page = shown(parts, verdict(["speed_rpm", "load_n"], "unknown", "unknown"), age_s=62)
    assert page["strip"] == "No speed and load data"
    assert "speed and load lost for 1 min 02 s" in page["texts"][0]


def test_a_service_that_gives_no_verdict_is_not_taken_for_a_safe_machine(parts: Page) -> None:
    for given, ago in ((None, 0), (verdict([], "safe", "safe"), 60_000)):
        page = shown(parts, given, heard_ago_ms=ago)
        assert page["words"] == ["Unknown"] * 3
        assert page["card"]["word"] == "Unknown"


def test_how_old_a_value_may_be_is_what_the_service_says(parts: Page) -> None:
    """A gateway that posts once a minute is no lost machine."""
    assert shown(parts, verdict([], "safe", "safe"), age_s=59)["chips"] == [["push", True, 0]]
    assert shown(parts, verdict([], "safe", "safe"), age_s=121)["chips"] == [["push", False, 5]]


def test_a_card_over_its_limit_keeps_its_colour_though_the_word_is_unknown(parts: Page) -> None:
    given = verdict(["load_n"], "unknown", "unknown")
    over = {"channel": "t_inner_ring_c", "level": "alarm", "value_c": 95}
    given["now"] |= {"limit": over, "reasons": ["Inner ring 97.0 °C, over alarm 95 °C"]}
    card = shown(parts, given)["card"]
    assert (card["word"], card["look"], card["group"]) == ("Unknown", "p1 solid", "over")
    assert card["lost"] is True


@pytest.mark.parametrize(("alarm", "look"), [(0.01, "p2"), (0.4, "p1")])
def test_a_step_in_hand_that_is_not_safe_is_said_beside_safe_now(
    parts: Page, alarm: float, look: str
) -> None:
    given = verdict([], "safe", "safe", "not safe")
    ahead = {"probability": 0.998, "alarm_probability": alarm, "seconds_to_limit": 480}
    given["present_step"] |= ahead
    page = shown(parts, given)
    assert page["words"] == ["Safe now", "Safe", "Not expected"]
    assert "not to the end of this step: over 70 °C in 8 min, > 99 %" in page["texts"][0]
    assert page["looks"][0] == f"ans {look}"
    assert page["card"]["look"] == "p2"
    assert page["card"]["group"] == "ahead"


def test_a_step_that_was_called_not_safe_says_so_though_its_forecast_is_better_now(
    parts: Page,
) -> None:
    given = verdict([], "safe", "safe", "not safe")
    why = "the step was called not safe before (6 %): that stands until it has ended or was changed"
    given["present_step"] |= {"reasons": ["Inner ring over warning 70 °C with 3 %", why]}
    page = shown(parts, given)
    assert page["words"][0] == "Safe now"
    assert why in page["texts"][0]


def test_over_a_limit_the_present_step_adds_nothing(parts: Page) -> None:
    given = verdict([], "not safe", "recovering", "not safe")
    page = shown(parts, given)
    assert page["words"][:2] == ["Not safe", "Recovering"]
    assert "this step" not in page["texts"][0]
