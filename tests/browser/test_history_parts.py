"""The ribbon of events under the history, and the way to it from a node."""

from urllib.parse import parse_qs, urlsplit

import pytest
from patience import patience
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
        f"""const {{ EventRibbon }} = await import('/js/history/event_ribbon.js');
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
        f"""const {{ EventRibbon }} = await import('/js/history/event_ribbon.js');
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
        """const { Section } = await import('/js/operator/section.js');
        const box = document.createElement('div');
        document.body.append(box);
        const opened = [];
        const { place } = await import('/js/parts/panel.js');
        place(box, Section, { open: (node) => opened.push(node),
          nodes: { 2: 40, 4: 50, 7: 45 }, spreads: { 7: 1 }, unknown: [],
          measured: { 4: { value: 50, usable: true } }, alerts: {}, stale: false });
        for (const selector of ['[data-node="4"]', '[data-pin="4"]', '[data-node="7"]']) {
          box.querySelector(selector).dispatchEvent(new MouseEvent('click', { bubbles: true }));
        }
        return opened;""",
    )
    assert opened == [4, 4]


#: A chart of two rings over an hour, with what it writes and strokes recorded by the canvas itself.
CHART = f"""
  document.head.innerHTML = ['css/tokens.css', 'css/base.css', 'vendor/uPlot.min.css']
    .map((path) => `<link rel="stylesheet" href="/${{path}}">`).join('');
  await new Promise((done) => {{
    const script = document.createElement('script');
    script.src = '/vendor/uPlot.iife.min.js';
    script.onload = done;
    document.head.append(script);
  }});
  await Promise.all([...document.styleSheets].map(() => document.fonts.ready));
  const {{ PastChart }} = await import('/js/charts/measured_chart.js');
  const box = document.createElement('div');
  box.style = 'position: relative; width: 900px; height: 400px';
  document.body.replaceChildren(box);
  const texts = [], strokes = [];
  const pen = CanvasRenderingContext2D.prototype;
  const {{ clearRect, fillText, lineTo }} = pen;
  pen.clearRect = function (...area) {{ // a new picture
    texts.length = strokes.length = 0;
    clearRect.apply(this, area);
  }};
  pen.fillText = function (text, x, y) {{
    texts.push({{ text, left: x, right: x + this.measureText(text).width, y,
      colour: this.fillStyle }});
    fillText.call(this, text, x, y);
  }};
  pen.lineTo = function (x, y) {{
    strokes.push({{ x, y, dash: this.getLineDash(), colour: this.strokeStyle }});
    lineTo.call(this, x, y);
  }};
  const line = (values) => ({{
    times: values.map((_, i) => {NOON_MS} + i * 600e3), values, low: values, high: values, gaps: [],
  }});
  const all = ['t_inner_ring_c', 't_inner_ring_c.twin', 't_outer_ring_c', 't_outer_ring_c.twin',
    'ambient_c'];
  const limits = {{ t_inner_ring_c: {{ warning: 70, alarm: 95 }},
    t_outer_ring_c: {{ warning: 65, alarm: 80 }} }};
  const chart = new PastChart(box,
    {{ title: 'Temperature', unit: '°C', syncKey: 'a', onZoom() {{}} }});
  const rings = {{ t_inner_ring_c: line([56, 59, 68, 79.4, 60, 45, 33]),
    t_outer_ring_c: line([33, 34, 40, 46, 40, 34, 27]) }};
  const drawn = async (more = {{}}) => {{
    chart.update({{ all, names: Object.keys(rings), lines: rings, limits, showTime: true,
      fromMs: {NOON_MS}, toMs: {NOON_MS} + 3600e3, notes: [], picked: null, ...more }});
    await new Promise((done) => setTimeout(done, 50));
    return texts.filter(({{ text }}) => / (warning|alarm) /.test(text)).map(({{ text }}) => text);
  }};
"""


def test_limits_are_those_of_the_line_that_came_closest_to_one(parts: Page) -> None:
    """79.4 °C of the inner ring is not "just below" the 80 °C of the outer ring."""
    texts = run(parts, CHART + "return drawn();")
    assert texts == ["inner ring warning 70 °C", "inner ring alarm 95 °C ↑"]


def test_a_limit_beyond_the_axis_is_an_arrow_at_its_edge(parts: Page) -> None:
    top, bottom, warning, alarm, below = run(
        parts,
        CHART
        + """await drawn();
        const { bbox } = chart.plot;
        const place = (wanted) => texts.find(({ text }) => text === wanted)?.y;
        const above = [place('inner ring warning 70 °C'), place('inner ring alarm 95 °C ↑')];
        rings.t_inner_ring_c = line([300, 301, 302, 303, 302, 301, 300]);
        delete rings.t_outer_ring_c;
        await drawn();
        const below = place('inner ring warning 70 °C ↓');
        return [bbox.top, bbox.top + bbox.height, ...above, below];""",
    )
    assert top <= alarm < top + 30 < warning < bottom
    assert bottom - 60 < below < bottom


def test_a_limit_has_the_dash_of_its_line_and_is_a_short_bar_at_its_end(parts: Page) -> None:
    marks = run(
        parts,
        CHART
        + """rings.t_outer_ring_c = line([33, 34, 66, 46, null, null, null]);
        await drawn({ picked: 't_outer_ring_c' });
        const { plot } = chart;
        const bars = (value) => {
          const y = plot.valToPos(value, 'y', true);
          const end = plot.valToPos(rings.t_outer_ring_c.times[3] / 1000, 'x', true);
          return strokes.filter((one) => Math.abs(one.y - y) < 0.01)
            .map(({ x, dash }) => [x - end, dash]);
        };
        return bars(65);""",
    )
    over, bar = marks  # the time over the limit, and the limit where its line ends
    assert over[0] < -50
    assert over[1] == []
    assert bar == [pytest.approx(0, abs=0.01), [10, 5]]


def test_what_is_exceeded_is_drawn_in_its_colour_whichever_line_is_picked(parts: Page) -> None:
    found = run(
        parts,
        CHART
        + """await drawn({ picked: 't_outer_ring_c' });
        const token = getComputedStyle(document.documentElement).getPropertyValue('--p2-text');
        return [texts.filter(({ text }) => / (warning|alarm) /.test(text))
          .map(({ text, colour }) => [text, colour]), token.trim()];""",
    )
    texts, amber = found
    assert [text for text, colour in texts if colour == amber] == ["inner ring warning 70 °C"]
    assert {text for text, _ in texts} == {
        "inner ring warning 70 °C",
        "outer ring warning 65 °C",
        "outer ring alarm 80 °C",
    }


def test_limits_follow_the_pointer_from_line_to_line(parts: Page) -> None:
    run(parts, CHART + "await drawn(); window.chart = chart; window.texts = texts;")
    place = "(name) => { const { plot } = chart; const at = plot.over.getBoundingClientRect();"
    place += "const i = chart.model.names.indexOf(name);"
    place += "return [at.left + plot.valToPos(plot.data[0][1], 'x'),"
    place += "at.top + plot.valToPos(plot.data[3 * i + 1][1], 'y')]; }"
    for name, wanted in (("t_outer_ring_c", "outer ring"), ("t_inner_ring_c", "inner ring")):
        x, y = parts.evaluate(place, name)
        parts.evaluate("texts.length = 0")
        parts.mouse.move(x, y)
        parts.wait_for_function(
            f"texts.some(({{ text }}) => text.startsWith('{wanted} alarm'))",
            timeout=patience(10_000),
        )


def test_texts_of_limits_never_cover_each_other(parts: Page) -> None:
    rows = run(
        parts,
        CHART
        + """limits.t_inner_ring_c = { warning: 70, alarm: 71 };
        await drawn();
        return texts.filter(({ text }) => / (warning|alarm) /.test(text)).map(({ y }) => y);""",
    )
    assert len(rows) == 2
    assert abs(rows[0] - rows[1]) >= 11


def test_the_text_of_a_limit_does_not_cover_the_name_of_a_line(parts: Page) -> None:
    """A short line at the right: its name stands where its limits beyond the axis would."""
    name, *limits = run(
        parts,
        CHART
        + f"const first = {NOON_MS} + 3000e3;"
        + """const late = (values) => (
          { ...line(values), times: values.map((_, i) => first + i * 60e3) });
        rings.t_inner_ring_c = late([40, 40, 40, 40, 40, 40, 40]);
        rings.t_outer_ring_c = late([31, 31, 31, 31, 31, 31, 31]);
        await drawn();
        return texts.filter(({ text }) => /Inner ring|inner ring/.test(text))
          .map(({ text, left, right, y }) => [text, left, right, y])
          .sort((a, b) => (a[0] < b[0] ? -1 : 1));""",
    )
    assert name[0] == "Inner ring"
    assert len(limits) == 2
    height = 12
    _, name_left, name_right, name_bottom = name
    for text, left, right, top in limits:
        beside = left >= name_right or right <= name_left
        assert beside or top >= name_bottom - 0.5 or top + height <= name_bottom - height, text
