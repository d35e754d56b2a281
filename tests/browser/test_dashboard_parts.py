"""The dashboard's parts, run in the browser that will run them."""

import hashlib
import re
from typing import Any

import pytest
from playwright.sync_api import Page, Route

from service.web.pages import static_directory

pytestmark = pytest.mark.browser

# A forecast made at the epoch: rows every 10 min over 60 min, one sensor, warming up.
FORECAST = """
const row = [60, 70, 80, 90, 100, 110, 120];
const forecast = {
  made_at: '1970-01-01T00:00:00.000Z',
  time_s: [0, 600, 1200, 1800, 2400, 3000, 3600],
  nodes: { t_inner_ring_c: {
    q025: row.map((v) => v - 4), q25: row.map((v) => v - 1), q50: row,
    q75: row.map((v) => v + 1), q975: row.map((v) => v + 4),
  } },
  profile: [
    { duration_s: 1200, speed_rpm: 4200, load_n: 2650 },
    { duration_s: 600, speed_rpm: 6200, load_n: 2650 },
    { duration_s: 1800, speed_rpm: 6200, load_n: 2650 },
  ],
  time_to_limit: { t_inner_ring_c: {
    warning: { probability: 1, median_s: 1800, earliest_s: 1500 },
    alarm: { probability: 0.9, median_s: 2700, earliest_s: 2400 },
  } },
};
const limits = { t_inner_ring_c: { warning: 90, alarm: 105 } };
"""


def run(page: Page, body: str, **arguments: Any) -> Any:
    """Run an asynchronous function body in the page; `arguments` are its variables."""
    names = ", ".join(arguments)
    return page.evaluate(f"async ({{{names}}}) => {{ {body} }}", arguments)


def test_the_band_of_the_whole_run_takes_the_place_of_the_other(parts: Page) -> None:
    shown = run(
        parts,
        FORECAST + "const { fanFrom } = await import('/js/forecast/forecast.js');"
        "const { BandChoice, chosenBand } = await import('/js/forecast/band_choice.js');"
        "const { place } = await import('/js/parts/panel.js');"
        "const t_inner_ring_c = forecast.time_s.map(() => 1.5);"
        "forecast.whole_run = { level: 0.9, factors: { t_inner_ring_c } };"
        "const fan = fanFrom(forecast, 900e3, ['t_inner_ring_c']);"
        "const page = {}; let drawn = 0;"
        "const shown = () => { const box = document.createElement('div');"
        "  place(box, BandChoice, { page, onchange: () => { drawn += 1; } }); return box; };"
        "const box = shown(); const [moment, whole] = box.querySelectorAll('button');"
        "const before = chosenBand(page, fan); whole.click(); await Promise.resolve();"
        "const after = chosenBand(page, fan); const other = shown().querySelectorAll('button');"
        "return { same: before === fan, drawn, band: after.bands.t_inner_ring_c,"
        " was: fan.bands.t_inner_ring_c,"
        " stated: after.stated, text: box.textContent,"
        " pressed: [moment, whole].map((one) => one.getAttribute('aria-pressed')),"
        " inner: !box.querySelector('.f50'), kept: other[1].getAttribute('aria-pressed'),"
        " none: chosenBand(page, null) };",
    )
    band, was = shown["band"], shown["was"]
    assert shown["same"]
    assert shown["drawn"] == 1
    for edge in ("q025", "q975"):
        wide = [1.5 * (at - middle) for at, middle in zip(was[edge], was["q50"], strict=True)]
        assert band[edge] == [a + b for a, b in zip(was["q50"], wide, strict=True)]
    assert band["q25"] == band["q75"] == band["q50"] == was["q50"], "half of all is another band"
    assert shown["stated"] in shown["text"]
    assert (shown["pressed"], shown["kept"]) == (["false", "true"], "true")
    assert shown["inner"]
    assert shown["none"] is None


def test_no_chance_of_a_limit_is_not_expected(parts: Page) -> None:
    answer, text = run(
        parts,
        FORECAST + "const f = await import('/js/forecast/forecast.js');"
        "const { timeAlongProfile } = await import('/js/forecast/verdict.js');"
        "const { timeToLimitTile } = await import('/js/forecast/tiles.js');"
        "const { nodesOf } = await import('/js/parts/panel.js');"
        "const high = { t_inner_ring_c: { warning: 200, alarm: 210 } };"
        "const none = { probability: 0.01, median_s: null, earliest_s: null };"
        "forecast.time_to_limit.t_inner_ring_c = { warning: none, alarm: none };"
        "const fan = f.fanFrom(forecast, 0, ['t_inner_ring_c']);"
        "const asked = { forecast, fan, readings: [], limits: high, nowMs: 0, safe: 0.05 };"
        "const answer = timeAlongProfile(asked);"
        "return [answer, nodesOf(timeToLimitTile(answer, { nowMs: 0, alone: false }))"
        "  .textContent];",
    )
    assert answer["expected"] is False
    assert text.replace("\u00a0", " ").startswith("Time to warning 200 °CNot expected1 %")


def test_what_the_server_sends_stays_text(parts: Page) -> None:
    shown = run(
        parts,
        """
        const { AlarmList } = await import('/js/alarms/list.js');
        const desk = { actionsOf: () => ['acknowledge'], text: () => 'Acknowledge',
          refusal: () => '', whyOffline: () => '' };
        const { place } = await import('/js/parts/panel.js');
        const box = document.createElement('div');
        const evil = '<img src=x onerror="window.broken = true">';
        const alarm = { id: evil, kind: evil, message: evil, state: 'ACKED', priority: 2,
          channel: evil, raised_at: '2026-11-21T08:00:00Z', acknowledged_by: evil };
        place(box, AlarmList, { desk, alarms: new Map([[evil, alarm]]),
          live: () => ({ value: () => null, crossing: () => null }) });
        document.documentElement.append(box);
        await new Promise((done) => setTimeout(done, 100));
        return { images: box.querySelectorAll('img').length, broken: window.broken ?? false,
          text: box.textContent };
        """,
    )
    assert shown["images"] == 0
    assert shown["broken"] is False
    assert shown["text"].count('<img src=x onerror="window.broken = true">') >= 3


def test_rows_stay_in_place_while_their_texts_change(parts: Page) -> None:
    same = run(
        parts,
        """
        const { AlarmList } = await import('/js/alarms/list.js');
        const desk = { actionsOf: () => ['acknowledge'], text: () => 'Acknowledge',
          refusal: () => '', whyOffline: () => '' };
        const { place } = await import('/js/parts/panel.js');
        const box = document.createElement('div');
        const alarm = { id: '1', kind: 'forecast limit', message: 'It will pass', priority: 2,
          state: 'UNACK', channel: 't_inner_ring_c', limit_level: 'warning', predicted: true,
          raised_at: '2026-11-21T08:00:00Z', lead_time_s: 1800, probability: 0.4 };
        const live = () => ({ value: () => null, crossing: () => null });
        const list = place(box, AlarmList, { desk, alarms: new Map([['1', alarm]]), live });
        const button = box.querySelector('button');
        const before = box.querySelector('.m span').textContent;
        list.update({ alarms: new Map([['1', { ...alarm, lead_time_s: 600 }]]) });
        return { same: button === box.querySelector('button'), before,
          after: box.querySelector('.m span').textContent };
        """,
    )
    assert same["same"] is True
    assert same["before"].replace("\u00a0", " ") == "predicted earliest in 30 min · 40 %"
    assert same["after"].replace("\u00a0", " ") == "predicted earliest in 10 min · 40 %"


ADVICE = {
    "target": {
        "speed_rpm": 6200,
        "load_n": 5500,
        "duration_s": 7200,
        "inside_low_risk": False,
        "sensor": "t_inner_ring_c",
        "sensors": {"t_inner_ring_c": {"q025": 70, "q50": 88.1, "q975": 122, "half_width_k": 26.0}},
        "labels": ["runaway not excluded"],
        "runaway_margin": {
            "speed_rpm": 6200,
            "load_n": 5500,
            "probability": 0.12,
            "margin_k": 9,
            "margin_n": -300,
        },
    },
    "worth_while": True,
    "ranked_by": "runaway",
    "next_step": {
        "text": "45 min at 2000 N, 4200 rpm: \u00b1 26.0 K at 5500 N becomes \u00b1 6.5 K.",
        "asked_half_width_k": 5,
        "reached": False,
        "rank": 1,
    },
    "steps": [
        {
            "rank": 1,
            "levels": [
                {"speed_rpm": 4200, "load_n": 2000, "duration_s": 2700},
                {"speed_rpm": 4200, "load_n": 3400, "duration_s": 2700},
            ],
            "duration_s": 5400,
            "half_width_k": {"t_inner_ring_c": 4.1},
            "cautious_half_width_k": {"t_inner_ring_c": 6.5},
            "runaway_probability": 0.034,
            "narrower_by": 0.75,
            "peak_c": {"t_inner_ring_c": 61.2},
            "why": "<b>two loads</b>",
        }
    ],
    "excluded": [
        {
            "levels": [{"speed_rpm": 2600, "load_n": 3400, "duration_s": 5400}],
            "reason": "changes speed and load at once",
        }
    ],
    "stop_rule": {
        "rules": ["Change one quantity at a time."],
        "levels": [
            {
                "speed_rpm": 5100,
                "load_n": 2650,
                "expected_c": {"t_inner_ring_c": 70.0},
                "stop_above_c": {"t_inner_ring_c": 78.4},
                "runaway_not_excluded": False,
                "allowed": True,
                "reason": "",
            }
        ],
    },
}


def test_advice_shows_steps_refusals_and_the_stop_rule(parts: Page) -> None:
    asked = []

    def answer(route: Route) -> None:
        asked.append(route.request.url)
        route.fulfill(json=ADVICE)

    parts.route("**/api/v1/assets/bench-1/advice*", answer)
    with parts.expect_response(lambda response: "half_width_k" in response.url):
        text = run(
            parts,
            """const { AdvicePanel } = await import('/js/engineer/advice_panel.js');
        const page = {
          store: { get: () => ({ low_risk: { speed_rpm_max: 4300, load_n_max: 3400 } }) },
          live: { assetId: 'bench-1' }, wish: { speed_rpm: 6200, load_n: 5500 },
        };
        const { place } = await import('/js/parts/panel.js');
        document.body.replaceChildren();
        place(document.body, AdvicePanel, { page, isReady: false });
        while (!document.querySelector('.adv table')) {
          await new Promise((resolve) => setTimeout(resolve, 20));
        }
        const wanted = document.querySelector('[aria-label^="Wanted half-width"]');
        wanted.value = '5';
        wanted.dispatchEvent(new Event('input', { bubbles: true }));
        document.querySelector('.e-adv form').requestSubmit();
        document.querySelectorAll('details').forEach((one) => { one.open = true; });
        return document.body.innerText;""",
        )
    assert asked[0].endswith("/api/v1/assets/bench-1/advice?speed_rpm=6200&load_n=5500")
    assert asked[1] == f"{asked[0]}&half_width_k=5"
    for said in (
        "45 min at 2000 N, 4200 rpm: ± 26.0 K at 5500 N becomes ± 6.5 K.",
        "4200 rpm, 2000 N 45 min, then 3400 N 45 min",
        "± 26.0",
        "± 6.5",
        "thermal runaway not ruled out",
        "Margin to thermal runaway: −300 N / 9 K, probability 12 %. Steps that leave",
        "Runaway after",
        "3 %",
        "1 step refused",
        "changes speed and load at once",
        "Change one quantity at a time.",
        "78.4",
        "<b>two loads</b>",
    ):
        assert said in text, said


def test_files_keep_to_the_rules_of_the_page() -> None:
    """Nothing from elsewhere, no HTML from text, no line that nobody can read."""
    own = [
        file
        for kind in ("js", "css", "html")
        for file in static_directory().rglob(f"*.{kind}")
        if "vendor" not in file.parts
    ]
    assert len(own) > 20
    for file in own:
        text = file.read_text(encoding="utf-8")
        assert not re.search(
            r"[iI]nnerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(", text
        )
        assert not re.search(r"""(src|href)=["']https?:|url\(https?:|from 'https?:""", text), file
        longest = max(len(line) for line in text.splitlines())
        assert longest <= 120, f"{file} has a line of {longest} characters"


def test_what_the_page_asks_for_is_there() -> None:
    index = (static_directory() / "index.html").read_text()
    wanted = re.findall(r'(?:href|src)="([^"#]+)"', index)
    assert len(wanted) > 5
    assert [name for name in wanted if not (static_directory() / name).is_file()] == []


def test_an_answer_that_breaks_off_is_no_answer(parts: Page) -> None:
    told = run(
        parts,
        "const { call } = await import('/js/app/api.js');"
        "const broken = new ReadableStream({ start: (c) => c.error(new TypeError('cut')) });"
        "const { fetch } = window;"
        "window.fetch = async () => new Response(broken);"
        "try { await call('/assets'); return null; }"
        "catch (error) { return [error.constructor.name, error.status, error.message]; }"
        "finally { window.fetch = fetch; }",
    )
    assert told == ["ApiError", 0, "the service does not answer"]


def test_vendored_parts_come_with_their_licences() -> None:
    static = static_directory()
    assert "MIT License" in (static / "vendor/uPlot-LICENSE.txt").read_text()
    assert "MIT License" in (static / "vendor/preact-LICENSE.txt").read_text()
    assert "SIL OPEN FONT LICENSE" in (static / "fonts/B612-OFL.txt").read_text()
    notice = (static / "vendor/NOTICE.txt").read_text()
    for script in (static / "vendor").glob("*.js"):
        digest = hashlib.sha256(script.read_bytes()).hexdigest()
        assert f"sha256 of vendor/{script.name}: {digest}" in notice
