"""In which order alarms are shown, and what the banner and the fleet's card make of them."""

import random
from dataclasses import replace
from itertools import product
from typing import Any

import pytest
from playwright.sync_api import Page

from service.alarms.records import normal_alarm, urgency
from service.alarms.states import AlarmState
from service.documents.alarms import alarm_document
from service.domain.alarm_condition import AlarmCondition
from tests.browser.test_dashboard_parts import run

pytestmark = pytest.mark.browser


def alarm(name: str, **facts: Any) -> dict[str, Any]:
    return {
        "id": name, "asset": "bench-1", "message": name, "kind": "measured limit",
        "channel": "t_inner_ring_c", "limit_level": "warning", "limit_value": 90, "priority": 2,
        "state": "UNACK", "predicted": False, "raised_at": "2026-11-22T08:00:00.000Z",
    } | facts  # fmt: skip


LOST = {"kind": "stale data", "channel": "source:push", "limit_level": None}
PREDICTED = {"kind": "forecast limit", "predicted": True}

RANKED = (
    "const { ranked, worst } = await import('/js/alarms.js');"
    "const all = new Map(alarms.map((one) => [one.id, one]));"
    "return [ranked(all).map((one) => one.id), worst(all)?.id ?? null];"
)


def test_unacknowledged_alarms_are_ranked_by_priority_then_by_how_certain_they_are(
    parts: Page,
) -> None:
    later = {"raised_at": "2026-11-22T09:00:00.000Z"}
    given = [
        alarm("lost 2", **LOST, **later),
        alarm("lost 1", **LOST, priority=1),
        alarm("predicted 2", **PREDICTED, **later),
        alarm("predicted 1", **PREDICTED, priority=1),
        alarm("over warning"),
        alarm("over warning later", **later),
        alarm("over alarm", priority=1),
        alarm("over alarm, seen", priority=1, state="ACKED", **later),
        alarm("shelved", priority=1, state="SHLVD", **later),
    ]
    order, first = run(parts, RANKED, alarms=given)
    assert order == [
        "over alarm", "lost 1", "predicted 1", "over warning later", "over warning", "lost 2",
        "predicted 2", "over alarm, seen", "shelved",
    ]  # fmt: skip
    assert first == "over alarm"


def test_the_service_lists_alarms_in_the_order_of_the_page(parts: Page) -> None:
    facts = [
        {"kind": kind, "predicted": predicted, "channel": channel}
        for kind, predicted, channel in (
            ("measured limit", False, "t_inner_ring_c"),
            ("stale data", False, "source:push"),
            ("sensor fault", False, "t_outer_ring_c"),
            ("forecast limit", True, "t_inner_ring_c"),
        )
    ]
    condition = AlarmCondition(
        "bench-1", "measured limit", "t_inner_ring_c", "warning", True, 91.0, "over warning", 2
    )
    one = normal_alarm(condition, 0)
    alarms = [
        replace(one, id=f"{number:03}", state=state.value, priority=priority, **fact)
        for number, (state, priority, fact) in enumerate(
            product(AlarmState, (1, 2, 3), facts), start=100
        )
        if state != AlarmState.NORM
    ]
    # No two at the same time; some were set aside before they were ever raised.
    alarms = [
        replace(each, since_us=time_us, raised_at_us=time_us if each.state != "DSUPR" else 0)
        for each, time_us in zip(alarms, range(10**15, 10**16, 10**12), strict=False)
    ]
    shuffled = random.Random(5).sample(alarms, len(alarms))
    documents = [alarm_document(each).model_dump(mode="json") for each in shuffled]
    order, _ = run(parts, RANKED, alarms=documents)
    assert order == [each.id for each in sorted(alarms, key=urgency)]


BANNER = """
const { Banner } = await import('/js/banner.js');
const { h } = await import('/js/dom.js');
const { Store, emptyAsset } = await import('/js/store.js');
const box = h('section');
let asked = 0;
const taken = [];
const desk = { refusal: () => '', take: (name, alarm) => taken.push([name, alarm.id]) };
const banner = new Banner(box, desk, () => { asked += 1; });
const state = { ...emptyAsset(), link: { status: 'live' }, alarmsKnown: true,
  alarms: new Map(alarms.map((one) => [one.id, one])) };
const live = () => ({ nowMs: Date.parse('2026-11-22T08:03:10.000Z'), value: () => null,
  crossing: () => null });
banner.update([{ store: new Store(state) }], { nameOf: () => '', live, blind });
const buttons = [...box.querySelectorAll('button, a')].filter((one) => !one.hidden);
const texts = buttons.map((one) => one.textContent);
buttons.find((one) => one.textContent.includes('more'))?.click();
buttons.find((one) => one.textContent === 'Acknowledge')?.click();
return { text: box.textContent, look: box.dataset.p ?? null, texts, asked, taken };
"""


def test_lost_data_enter_the_banner_and_are_acknowledged_there(parts: Page) -> None:
    lost = alarm("No data from pt100 (6 channels)", **LOST)
    shown = run(parts, BANNER, alarms=[lost, alarm("predicted", **PREDICTED)], blind=True)
    assert shown["look"] == "bad"
    text = shown["text"].replace("\u00a0", " ")
    assert "No data from pt100 (6 channels)" in text
    assert "for 3 min" in text
    assert "unacknowledged since" in text
    assert shown["texts"] == ["+ 1 more", "Acknowledge", "Shelve…"]
    assert shown["asked"] == 1
    assert shown["taken"] == [["acknowledge", "No data from pt100 (6 channels)"]]


def test_a_quiet_banner_does_not_promise_alarms_that_cannot_come(parts: Page) -> None:
    suppressed = [alarm("a", state="SHLVD", **LOST), alarm("b", state="DSUPR")]
    shown = run(parts, BANNER, alarms=suppressed, blind=True)
    assert shown["text"].startswith("Limit alarms not available: no data")
    assert shown["texts"] == ["2 suppressed"]
    assert run(parts, BANNER, alarms=[], blind=False)["text"].startswith("No active alarms")


def test_the_summary_says_how_alarms_are_suppressed(parts: Page) -> None:
    text = run(
        parts,
        "const { summary } = await import('/js/alarms.js');"
        "return summary(new Map(alarms.map((one) => [one.id, one])));",
        alarms=[
            alarm("a"), alarm("b", state="ACKED"), alarm("c", state="RTNUN"),
            alarm("d", state="SHLVD"), alarm("e", state="DSUPR"), alarm("f", state="DSUPR"),
        ],
    )  # fmt: skip
    assert text == "2 active, 2 unacknowledged, 3 suppressed (shelved 1, by design 2)"


def test_an_alarm_that_only_rises_fast_is_not_over_a_limit(parts: Page) -> None:
    standing = run(
        parts,
        "const { standingAlarm } = await import('/js/fleet_verdict.js');"
        "return standingAlarm(new Map(alarms.map((one) => [one.id, one])))?.id ?? null;",
        alarms=[
            alarm("rises", kind="rate of rise", priority=1),
            alarm("over warning"),
            alarm("back", priority=1, state="RTNUN"),
            alarm("will pass", priority=1, **PREDICTED),
        ],
    )
    assert standing == "over warning"
