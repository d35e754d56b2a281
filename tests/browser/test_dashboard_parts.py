"""The dashboard's parts, run in the browser that will run them."""

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


@pytest.mark.parametrize(
    ("limit", "expected"),
    [(80, 0.5), (90, 0.25), (109.06, 0.025), (120, 0.004), (40, 0.996)],
)
def test_probability_is_read_from_quantiles(parts: Page, limit: float, expected: float) -> None:
    # A normal distribution of mean 80 and standard deviation 14.826.
    quantiles = [50.94, 70, 80, 90, 109.06]
    probability = run(
        parts,
        "const { probabilityOver } = await import('/js/forecast.js');"
        "return probabilityOver(quantiles, limit);",
        quantiles=quantiles,
        limit=limit,
    )
    assert probability == pytest.approx(expected, abs=0.002)


def test_the_fan_begins_at_now(parts: Page) -> None:
    fan = run(
        parts,
        FORECAST + "const { fanFrom } = await import('/js/forecast.js');"
        "return fanFrom(forecast, 900e3, ['t_inner_ring_c']);",
    )
    assert fan["times"] == [900e3, 1200e3, 1800e3, 2400e3, 3000e3, 3600e3]
    assert fan["bands"]["t_inner_ring_c"]["q50"] == [75, 80, 90, 100, 110, 120]


def test_the_band_of_the_whole_run_takes_the_place_of_the_other(parts: Page) -> None:
    shown = run(
        parts,
        FORECAST + "const { fanFrom } = await import('/js/forecast.js');"
        "const { BandChoice } = await import('/js/band_choice.js');"
        "const t_inner_ring_c = forecast.time_s.map(() => 1.5);"
        "forecast.whole_run = { level: 0.9, factors: { t_inner_ring_c } };"
        "const fan = fanFrom(forecast, 900e3, ['t_inner_ring_c']);"
        "const page = {}; let drawn = 0;"
        "const choice = new BandChoice(page, () => { drawn += 1; });"
        "const before = choice.drawn(fan); const [moment, whole] = choice.buttons; whole.click();"
        "const after = choice.drawn(fan); const other = new BandChoice(page, () => {});"
        "return { same: before === fan, drawn, band: after.bands.t_inner_ring_c,"
        " was: fan.bands.t_inner_ring_c,"
        " stated: after.stated, text: choice.element.textContent,"
        " pressed: [moment, whole].map((one) => one.getAttribute('aria-pressed')),"
        " inner: choice.inner.hidden, kept: other.buttons[1].getAttribute('aria-pressed'),"
        " none: choice.drawn(null) };",
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


def test_a_forecast_that_has_run_out_or_ran_away_is_cut(parts: Page) -> None:
    cut = run(
        parts,
        FORECAST + "const { fanFrom } = await import('/js/forecast.js');"
        "const names = ['t_inner_ring_c'];"
        "const late = fanFrom(forecast, 3600e3, names);"
        "forecast.nodes.t_inner_ring_c.q975[3] = null;"
        "return [late, fanFrom(forecast, 0, names).times];",
    )
    assert cut[0] is None
    assert cut[1] == [0, 600e3, 1200e3]


def test_a_profile_is_judged_over_its_whole_length(parts: Page) -> None:
    answer = run(
        parts,
        FORECAST + "const f = await import('/js/forecast.js');"
        "const { judgeProfile } = await import('/js/verdict.js');"
        "const fan = f.fanFrom(forecast, 900e3, ['t_inner_ring_c']);"
        "return judgeProfile({ forecast, fan, limits, nowMs: 900e3 });",
    )
    assert answer["word"] == "not safe"
    assert answer["priority"] == 1
    assert answer["peak"]["median"] == 120


def test_time_along_a_profile_counts_from_now_and_turns_to_the_alarm(parts: Page) -> None:
    ask = (
        FORECAST + "const f = await import('/js/forecast.js');"
        "const { timeAlongProfile } = await import('/js/verdict.js');"
        "const nowMs = 900e3;"
        "const fan = f.fanFrom(forecast, nowMs, ['t_inner_ring_c']);"
        "const readings = [{ sensor: 't_inner_ring_c', value, usable: true }];"
        "return timeAlongProfile({ forecast, fan, readings, limits, nowMs });"
    )
    before = run(parts, ask, value=75)
    assert (before["level"], before["median"], before["expected"]) == ("warning", 900, True)
    over = run(parts, ask, value=92)
    assert (over["level"], over["limitC"], over["earliest"]) == ("alarm", 105, 1500)


def test_no_chance_of_a_limit_is_not_expected(parts: Page) -> None:
    answer, text = run(
        parts,
        FORECAST + "const f = await import('/js/forecast.js');"
        "const { timeAlongProfile } = await import('/js/verdict.js');"
        "const { timeToLimitTile } = await import('/js/tiles.js');"
        "const high = { t_inner_ring_c: { warning: 200, alarm: 210 } };"
        "const none = { probability: 0.01, median_s: null, earliest_s: null };"
        "forecast.time_to_limit.t_inner_ring_c = { warning: none, alarm: none };"
        "const fan = f.fanFrom(forecast, 0, ['t_inner_ring_c']);"
        "const answer = timeAlongProfile({ forecast, fan, readings: [], limits: high, nowMs: 0 });"
        "return [answer, timeToLimitTile(answer, { nowMs: 0, alone: false }).textContent];",
    )
    assert answer["expected"] is False
    assert text.replace("\u00a0", " ").startswith("Time to warning 200 °CNot expected1 %")


def test_process_clock_finds_the_rate_and_runs_on(parts: Page) -> None:
    found = run(
        parts,
        "const { ProcessClock } = await import('/js/clock.js');"
        "const clock = new ProcessClock();"
        "clock.update(1e12, 5e11);"
        "clock.update(1e12 + 3 * 120e3, 5e11 + 3000);"
        "const [first, began] = [clock.now(), performance.now()];"
        "await new Promise((done) => setTimeout(done, 200));"
        "const wall = performance.now() - began;"
        "return { rate: clock.rate, ran: (clock.now() - first) / wall };",
    )
    assert found["rate"] == 120
    assert found["ran"] == pytest.approx(120, rel=0.02)


def test_what_the_server_sends_stays_text(parts: Page) -> None:
    shown = run(
        parts,
        """
        const { AlarmList } = await import('/js/alarm_list.js');
        const desk = { actionsOf: () => ['acknowledge'], text: () => 'Acknowledge',
          refusal: () => '', away: () => '' };
        const { h } = await import('/js/dom.js');
        const box = h('div');
        const list = new AlarmList(box, desk);
        const evil = '<img src=x onerror="window.broken = true">';
        const alarm = { id: evil, kind: evil, message: evil, state: 'ACKED', priority: 2,
          channel: evil, raised_at: '2026-11-21T08:00:00Z', acknowledged_by: evil };
        list.update(new Map([[evil, alarm]]), () => ({ value: () => null, crossing: () => null }));
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
        const { AlarmList } = await import('/js/alarm_list.js');
        const desk = { actionsOf: () => ['acknowledge'], text: () => 'Acknowledge',
          refusal: () => '', away: () => '' };
        const { h } = await import('/js/dom.js');
        const box = h('div');
        const list = new AlarmList(box, desk);
        const alarm = { id: '1', kind: 'forecast limit', message: 'It will pass', priority: 2,
          state: 'UNACK', channel: 't_inner_ring_c', limit_level: 'warning', predicted: true,
          raised_at: '2026-11-21T08:00:00Z', lead_time_s: 1800, probability: 0.4 };
        const live = () => ({ value: () => null, crossing: () => null });
        list.update(new Map([['1', alarm]]), live);
        const button = box.querySelector('button');
        const before = box.querySelector('.m span').textContent;
        list.update(new Map([['1', { ...alarm, lead_time_s: 600 }]]), live);
        return { same: button === box.querySelector('button'), before,
          after: box.querySelector('.m span').textContent };
        """,
    )
    assert same["same"] is True
    assert same["before"].replace("\u00a0", " ") == "predicted earliest in 30 min · 40 %"
    assert same["after"].replace("\u00a0", " ") == "predicted earliest in 10 min · 40 %"


# A plane of 3 speeds and 2 loads; time to a limit that slow points never reach.
PLANE = """
const p = await import('/js/plane.js');
const { planeOf, valueAt, nearestAt, contour } = p;
const plane = planeOf({ speed_rpm: [1000, 2000, 3000], load_n: [500, 1500] });
const temperatures = [[30, 40, 50], [40, 50, 60]];
const times = [[null, null, 3600], [null, 7200, 1800]];
"""


def test_values_between_grid_points_are_interpolated(parts: Page) -> None:
    found = run(
        parts,
        PLANE
        + """return {
          corner: valueAt(plane, temperatures, 1000, 500),
          between: valueAt(plane, temperatures, 1500, 1000),
          outside: valueAt(plane, temperatures, 9000, 9000),
          unknown: valueAt(plane, times, 1500, 1000),
          nearest: nearestAt(plane, times, 2900, 1400),
          never: nearestAt(plane, times, 1100, 600),
        };""",
    )
    assert found == {
        "corner": 30,
        "between": 40,
        "outside": 60,
        "unknown": None,
        "nearest": 1800,
        "never": None,
    }


def test_contours_lie_where_the_level_is(parts: Page) -> None:
    """On this plane T = 30 + (speed - 1000) / 100 + (load - 500) / 100."""
    segments = run(parts, PLANE + "return contour(plane, temperatures, 45, 30);")
    assert len(segments) >= 30
    for segment in segments:
        for speed, load in segment:
            assert 30 + (speed - 1000) / 100 + (load - 500) / 100 == pytest.approx(45, abs=0.01)
    loads = [load for segment in segments for _, load in segment]
    assert min(loads) == pytest.approx(500, abs=40)
    assert max(loads) == pytest.approx(1500, abs=40)
    assert run(parts, PLANE + "return contour(plane, temperatures, 99, 30);") == []
    segments, lines = run(
        parts,
        PLANE
        + "const found = contour(plane, temperatures, 44.7, 30);return [found, p.joined(found)];",
    )
    assert [len(line) for line in lines] == [len(segments) + 1], "one line from edge to edge"


@pytest.mark.parametrize(
    ("warning", "alarm", "word", "priority"),
    [
        (0.049, 0.0, "safe", 0),
        (0.05, 0.0, "risk", 2),
        (0.5, 0.1, "unsafe", 2),
        (0.9, 0.2, "unsafe", 1),
    ],
)
def test_the_word_for_a_point_of_the_envelope(
    parts: Page, warning: float, alarm: float, word: str, priority: int
) -> None:
    found = run(
        parts,
        "const { verdictAt } = await import('/js/views/envelope.js');"
        "return verdictAt(warning, alarm);",
        warning=warning,
        alarm=alarm,
    )
    assert found == {"word": word, "priority": priority}


def test_steps_of_the_advice_are_said_shortly(parts: Page) -> None:
    text = run(
        parts,
        """const { stepText } = await import('/js/advice.js');
        return stepText([
          { speed_rpm: 4200, load_n: 2000, duration_s: 2700 },
          { speed_rpm: 4200, load_n: 3400, duration_s: 7200 },
          { speed_rpm: 3000, load_n: 3400, duration_s: 600 },
        ]);""",
    )
    assert text == "4200 rpm, 2000 N 45 min, then 3400 N 2 h 00 min, then 3000 rpm, 3400 N 10 min"


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
    text = run(
        parts,
        """const { AdvicePanel } = await import('/js/advice.js');
        const page = {
          store: { get: () => ({ low_risk: { speed_rpm_max: 4300, load_n_max: 3400 } }) },
          live: { assetId: 'bench-1' }, wish: { speed_rpm: 6200, load_n: 5500 },
        };
        const panel = new AdvicePanel(page);
        document.body.append(panel.element);
        while (!panel.element.querySelector('.adv table')) {
          await new Promise((resolve) => setTimeout(resolve, 20));
        }
        panel.element.querySelectorAll('details').forEach((one) => { one.open = true; });
        return panel.element.innerText;""",
    )
    assert asked[0].endswith("/api/v1/assets/bench-1/advice?speed_rpm=6200&load_n=5500")
    for said in (
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
        assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(", text)
        assert not re.search(r"""(src|href)=["']https?:|url\(https?:|from 'https?:""", text), file
        longest = max(len(line) for line in text.splitlines())
        assert longest <= 120, f"{file} has a line of {longest} characters"


def test_what_the_page_asks_for_is_there() -> None:
    index = (static_directory() / "index.html").read_text()
    wanted = re.findall(r'(?:href|src)="([^"#]+)"', index)
    assert len(wanted) > 30
    assert [name for name in wanted if not (static_directory() / name).is_file()] == []


def test_an_answer_that_breaks_off_is_no_answer(parts: Page) -> None:
    told = run(
        parts,
        "const { call } = await import('/js/api.js');"
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
    assert "SIL OPEN FONT LICENSE" in (static / "fonts/B612-OFL.txt").read_text()


@pytest.mark.parametrize(
    ("speed_rpm", "reading", "expected"),
    [
        (1900, 77.1, 1.0),  # measured over the limit, where the map says 36 %
        (1900, 69.9, 0.36),
        (1900, None, 0.36),
        (1000, 77.1, 0.0),  # another point of the map
    ],
)
def test_the_present_point_is_rated_no_lower_than_what_is_measured(
    parts: Page, speed_rpm: float, reading: float | None, expected: float
) -> None:
    chance = run(
        parts,
        "const { chanceAt, planeOf } = await import('/js/plane.js');"
        "const plane = planeOf({ speed_rpm: [1000, 2000], load_n: [1000, 3000] });"
        "const map = { limit_c: 70, steady_probability: [[0, 0.4], [0, 0.4]] };"
        "const present = { speed: 1900, load: 2650, reading };"
        "return chanceAt(plane, map, { speed, load: 2650 }, present);",
        speed=speed_rpm,
        reading=reading,
    )
    assert chance == pytest.approx(expected)
