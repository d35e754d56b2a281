"""The ribbon of events under the history, and the way to it from a node."""

from urllib.parse import parse_qs, urlsplit

import pytest
from playwright.sync_api import Page, Route

from tests.browser.test_dashboard_parts import run

pytestmark = pytest.mark.browser

NOON_MS = 1_764_072_000_000  # 2025-11-25T12:00:00Z
JOURNAL = [
    {
        "time": "2025-11-25T12:30:00.000Z",
        "class": "alarm",
        "from": "NORM",
        "to": "UNACK",
        "kind": "measured limit",
        "message": "Inner ring over warning 70 °C",
        "priority": 2,
    },
    {
        "time": "2025-11-25T12:40:00.000Z",
        "class": "alarm",
        "from": "UNACK",
        "to": "ACKED",
        "kind": "measured limit",
        "message": "Inner ring over warning 70 °C",
        "priority": 2,
    },
    {
        "time": "2025-11-25T12:45:00.000Z",
        "class": "event",
        "kind": "model activated",
        "message": "Model version 3 activated",
        "comment": "passed its gates",
    },
    {"time": "2025-11-25T11:59:00.000Z", "class": "event", "kind": "grease renewed"},
]


def test_alarms_and_events_stand_at_their_time(parts: Page) -> None:
    asked: list[str] = []

    def answer(route: Route) -> None:
        asked.append(route.request.url)
        route.fulfill(json={"items": JOURNAL, "next": None})

    parts.route("**/api/v1/alarms/journal*", answer)
    marks = run(
        parts,
        f"""const {{ EventRibbon }} = await import('/js/event_ribbon.js');
        const ribbon = new EventRibbon('#alarms');
        document.body.append(ribbon.element);
        const span = {{ fromMs: {NOON_MS}, toMs: {NOON_MS} + 3600e3 }};
        await ribbon.load('bench-1', span);
        ribbon.show(span, {{ left: 40, width: 400 }});
        return [...ribbon.element.querySelectorAll('i')].map((one) =>
          [one.className, parseFloat(one.closest('li').style.left) + parseFloat(one.style.left),
            one.closest('a').textContent, one.closest('a').getAttribute("href")]);""",
    )
    query = parse_qs(urlsplit(asked[0]).query)
    assert query["asset"] == ["bench-1"]
    assert query["start"] == ["2025-11-25T12:00:00.000Z"]
    assert [(look, left, href) for look, left, _, href in marks] == [
        ("p2", 200, "#alarms"),
        ("event", 300, "#alarms"),
    ]
    assert "Inner ring over warning 70 °C raised" in marks[0][2]
    assert "Model version 3 activated, passed its gates" in marks[1][2]


def test_marks_that_lie_close_together_share_a_link(parts: Page) -> None:
    journal = [{**JOURNAL[0], "time": f"2025-11-25T12:30:{second:02}.000Z"} for second in range(8)]
    parts.route("**/api/v1/alarms/journal*", lambda route: route.fulfill(json={"items": journal}))
    links = run(
        parts,
        f"""const {{ EventRibbon }} = await import('/js/event_ribbon.js');
        const ribbon = new EventRibbon('#alarms');
        document.body.append(ribbon.element);
        const span = {{ fromMs: {NOON_MS}, toMs: {NOON_MS} + 3600e3 }};
        await ribbon.load('bench-1', span);
        ribbon.show(span, {{ left: 40, width: 400 }});
        return [...ribbon.element.querySelectorAll('a')].map((one) =>
          [one.querySelectorAll('i').length, one.title]);""",
    )
    assert [count for count, _ in links] == [8]
    assert links[0][1].endswith("3 more")


def test_a_measured_node_opens_its_history_and_no_other(parts: Page) -> None:
    opened = run(
        parts,
        """const { Section } = await import('/js/section.js');
        const box = document.createElement('div');
        document.body.append(box);
        const opened = [];
        const section = new Section(box, (node) => opened.push(node));
        section.update({ nodes: { 2: 40, 4: 50, 7: 45 }, spreads: { 7: 1 }, unknown: [],
          measured: { 4: { value: 50, usable: true } }, alerts: {}, stale: false });
        for (const selector of ['[data-node="4"]', '[data-pin="4"]', '[data-node="7"]']) {
          box.querySelector(selector).dispatchEvent(new MouseEvent('click', { bubbles: true }));
        }
        return opened;""",
    )
    assert opened == [4, 4]
