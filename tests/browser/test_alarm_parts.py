"""In which order alarms are shown, and what the banner and the fleet's card make of them."""

from typing import Any

import pytest
from playwright.sync_api import Page

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


BANNER = """
const { Banner } = await import('/js/app/frame.js');
const { h } = await import('/js/parts/dom.js');
const { emptyAsset } = await import('/js/live/store.js');
const box = h('section');
let asked = 0;
const taken = [];
const desk = { refusal: () => '', take: (name, alarm) => taken.push([name, alarm.id]) };
const banner = new Banner(box, desk, () => { asked += 1; });
const state = { ...emptyAsset(), link: { status: 'live' }, alarmsKnown: true };
const live = () => ({ nowMs: Date.parse('2026-11-22T08:03:10.000Z'), value: () => null,
  crossing: () => null });
banner.update(alarms, { nameOf: () => '', live, blind, states: [state] });
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


def test_a_probability_is_shown_once_and_outside_of_what_is_announced(parts: Page) -> None:
    """It changes with each forecast: a screen reader must not say the alarm again each time."""
    text = "Inner ring may exceed warning 70 °C"
    given = alarm("a", message=f"{text}, 21 %", probability=0.21, lead_time_s=7200, **PREDICTED)
    announced = BANNER.replace(
        "{ text:", "{ said: box.querySelector('[role=status]').textContent, text:"
    )
    shown = run(parts, announced, alarms=[given], blind=False)
    assert shown["said"].replace("\u00a0", " ") == f"PREDICTED {text}"
    assert shown["text"].replace("\u00a0", " ").count("21 %") == 1


def test_a_quiet_banner_does_not_promise_alarms_that_cannot_come(parts: Page) -> None:
    suppressed = [alarm("a", state="SHLVD", **LOST), alarm("b", state="DSUPR")]
    shown = run(parts, BANNER, alarms=suppressed, blind=True)
    assert shown["text"].startswith("Limit alarms not available: no data")
    assert shown["texts"] == ["2 suppressed"]
    assert run(parts, BANNER, alarms=[], blind=False)["text"].startswith("No active alarms")


GATEWAY = {
    "kind": "stale data", "channel": "source:gateway-1", "limit_level": None, "asset": None,
    "cause": {"kind": "source", "id": "gateway-1"}, "message": "gateway-1: no data, 200 assets",
    "assets": [f"bench-{number}" for number in range(1, 201)],
}  # fmt: skip

ONE_ROW = """
const { AlarmList } = await import('/js/alarms/list.js');
const desk = { actionsOf: () => ['acknowledge'], text: (name) => name,
  refusal: () => '', whyOffline: () => '' };
const { draw, v } = await import('/js/parts/panel.js');
const box = document.createElement('div');
document.body.append(box);
const live = () => ({ nowMs: Date.parse('2026-11-22T08:03:10.000Z'), value: () => null });
const byId = new Map(alarms.map((one) => [one.id, one]));
draw(box, v(AlarmList, { desk, alarms: byId, live, nameOf: () => '' }));
const rows = [...box.querySelectorAll('li')].map((row) => row.querySelector('.m').innerText);
box.querySelector('button.link').click();
await new Promise((resolve) => setTimeout(resolve, 50));
const dialog = document.querySelector('dialog');
const links = [...dialog.querySelectorAll('.assets a')].map((one) => one.getAttribute('href'));
dialog.close('');
box.remove();
return { rows, links };
"""


def test_a_lost_source_is_one_row_with_the_list_of_its_assets(parts: Page) -> None:
    shown = run(parts, ONE_ROW, alarms=[alarm("a", **GATEWAY)])
    assert len(shown["rows"]) == 1
    row = shown["rows"][0].replace("\u00a0", " ")
    assert row.startswith("gateway-1: no data, 200 assets")
    assert "List of 200 assets" in row
    assert len(shown["links"]) == 200
    assert shown["links"][41] == "#operator/bench-42"


SHARED = """
const { Live } = await import('/js/live/live.js');
const { ProcessClock } = await import('/js/live/clock.js');
const live = new Live(new ProcessClock(), { onLoggedOut() {}, onAssets() {}, onFeed() {} });
live.assets = new Map(alarms[0].assets.map((id) => [id, { id }]));
const feeds = ['bench-1', 'bench-2', 'bench-3'].map((id) => live.feedOf(id));
const message = (data) => live.receive({ type: 'alarm', asset: null, epoch: 'e', seq: 1, data,
  time: '2026-11-22T08:03:10.000Z', sent_at: '2026-11-22T08:03:10.000Z' });
const told = [];
for (const alarm of alarms) {
  message(alarm);
  told.push([live.alarms().length, live.feeds.size,
    feeds.map((feed) => feed.store.get('alarms').size)]);
}
return told;
"""


def test_the_alarm_of_a_source_is_known_once_and_to_the_assets_that_it_names(parts: Page) -> None:
    given = alarm("a", **GATEWAY)
    told = run(
        parts,
        SHARED,
        alarms=[
            given,
            given | {"assets": ["bench-2"], "asset": "bench-2"},
            given | {"assets": ["bench-2", "bench-77"]},
            given | {"state": "NORM"},
        ],
    )
    assert told == [
        [1, 3, [1, 1, 1]],
        [1, 3, [0, 1, 0]],
        [1, 3, [0, 1, 0]],
        [0, 3, [0, 0, 0]],
    ], "none of 200 assets gets a feed for it"
