"""What the planning views compute by themselves, in a real browser without a service."""

from typing import Any

import pytest
from playwright.sync_api import Page

pytestmark = pytest.mark.browser

STEPS = [
    {"speed_rpm": 4400, "load_n": 5500, "minutes": 45},
    {"speed_rpm": 6200, "load_n": 3900.5, "minutes": 75},
]


def run(page: Page, script: str, **given: Any) -> Any:
    """Run statements in the page with the modules of the dashboard; they return the answer."""
    names = ", ".join(given)
    return page.evaluate(f"async ({{ {names} }}) => {{ {script} }}", given)


def test_a_link_says_what_is_tried(parts: Page) -> None:
    link, back = run(
        parts,
        "const p = await import('/js/profile.js');"
        "const link = p.linkOf(steps, true); return [link, p.fromLink(link)];",
        steps=STEPS,
    )
    assert link == "steps=4400_5500_45-6200_3900.5_75&from=end"
    assert back == {"steps": STEPS, "fromEnd": True}


@pytest.mark.parametrize(
    "query",
    ["", "steps=", "steps=4400_5500", "steps=4400_5500_0", "steps=4400_5500_45-99999_1_5",
     "steps=a_b_c", "steps=4400_-1_45", "from=end"],
)  # fmt: skip
def test_a_link_that_cannot_be_tried_is_left_aside(parts: Page, query: str) -> None:
    script = "const p = await import('/js/profile.js'); return p.fromLink(query);"
    assert run(parts, script, query=query) is None


def test_sliders_reach_beyond_the_low_risk_region_and_everything_planned(parts: Page) -> None:
    small, large = run(
        parts,
        "const p = await import('/js/profile.js');"
        "return [p.fieldsFor({ speed_rpm_max: 4300, load_n_max: 3400 }, steps),"
        " p.fieldsFor({ speed_rpm_max: 18, load_n_max: 60000 }, steps.slice(0, 0))];",
        steps=STEPS,
    )
    assert (small["speed_rpm"]["high"], small["load_n"]["high"]) == (7000, 7500)
    assert (small["speed_rpm"]["step"], small["load_n"]["step"]) == (50, 50)
    assert (large["speed_rpm"]["high"], large["load_n"]["high"]) == (500, 135000)
    assert large["load_n"]["step"] == 500


def test_the_latest_question_is_asked_next_and_older_ones_are_dropped(parts: Page) -> None:
    told = run(
        parts,
        """const { LatestQuestion } = await import('/js/latest.js');
        const [asked, answered, failed] = [[], [], []];
        let settle;
        const line = new LatestQuestion({
          ask: (question) => {
            asked.push(question);
            return new Promise((good, bad) => { settle = { good, bad }; });
          },
          answered: (answer) => answered.push(answer),
          failed: (error) => failed.push(error.message),
        });
        const settled = () => new Promise((done) => setTimeout(done));
        for (const question of [1, 2, 3, 4]) line.put(question);
        settle.good('re 1');
        await settled();
        line.put(5);
        settle.bad(new Error('no'));
        await settled();
        settle.good('re 5');
        await settled();
        line.put(6);
        line.put(7);
        line.stop();
        settle.bad(new Error('aborted'));
        await settled();
        return { asked, answered, failed };""",
    )
    assert told == {"asked": [1, 4, 5, 6], "answered": ["re 1", "re 5"], "failed": ["no"]}


def test_the_highest_speed_is_the_last_below_five_percent(parts: Page) -> None:
    """The chance falls at first (a standing machine is worst) and then grows with the speed."""
    found = run(
        parts,
        """const { highestSpeed } = await import('/js/highest_speed.js');
        let asked = 0;
        const seek = (chance) => highestSpeed({
          low: 0, high: 7000, step: 50,
          profileAt: (speed) => speed,
          ask: async (speed) => {
            asked += 1;
            return {
              limits: { a: { warning: 90 }, b: { warning: 80 } },
              time_to_limit: { a: { warning: { probability: chance(speed) } },
                b: { warning: { probability: 0.001 } } },
            };
          },
        });
        const real = await seek((speed) => (speed < 300 ? 0.3 : (speed / 7000) ** 3 * 0.4));
        return { real, asked, open: await seek(() => 0.01), none: await seek(() => 0.06) };""",
    )
    assert found["real"]["speed"] == 3450, "just below 3500 rpm it is 5 %"
    assert (found["real"]["limit"], found["real"]["sensor"]) == (90, "a")
    assert found["asked"] <= 12
    assert (found["open"]["speed"], found["open"]["open"]) == (7000, True)
    assert found["none"]["speed"] is None


@pytest.mark.parametrize(
    ("versions", "before"),
    [([1], None), ([1, 2], 1), ([1, 2, 1], None), ([1, 2, 4, 2], 1), ([1, 2, 1, 3], 1), ([], None)],
)
def test_a_roll_back_leads_to_the_version_before(
    parts: Page, versions: list[int], before: int | None
) -> None:
    script = (
        "const { versionBefore } = await import('/js/version_panel.js');"
        "return versionBefore(versions.map((version) => ({ version })).reverse());"
    )
    assert run(parts, script, versions=versions) == before


def test_a_version_that_failed_a_gate_is_not_offered(parts: Page) -> None:
    gates = {
        "checks": [{"passed": True, "detail": "fit: fine"}, {"passed": False, "detail": "bad"}]
    }
    script = (
        "const { offer } = await import('/js/version_panel.js');"
        "return ['candidate', 'rejected', 'active', 'retired'].map((status) =>"
        " offer({ version: 3, status, gates, reason: 'why' }));"
    )
    candidate, rejected, active, retired = run(parts, script, gates=gates)
    assert (candidate["offered"], retired["offered"]) == (True, True)
    assert (active["offered"], rejected["offered"], rejected["kept"]) == (False, False, True)
    assert rejected["text"] == "v3 is stored, not offered: 1 of 2 gates passed. bad."


def test_high_risk_spans_and_holes_are_found_in_the_minutes(parts: Page) -> None:
    minute = 60_000
    rows = [[number * minute, 3000.0, 2000.0] for number in range(40) if not 20 <= number < 30]
    for number in (5, 6, 8):
        rows[number][1] = 4600.0
    rows[35 - 10][2] = 3700.0
    found = run(
        parts,
        """const { OperationMinutes } = await import('/js/minutes.js');
        const minutes = new OperationMinutes('a');
        for (const [ms, speed_rpm, load_n] of rows) minutes.minutes.set(ms, { speed_rpm, load_n });
        return { risky: minutes.highRisk({ speed_rpm_max: 4300, load_n_max: 3400 }),
          runs: minutes.speedRuns(60000).map((run) => run.length) };""",
        rows=rows,
    )
    assert [(one["fromMs"] / minute, one["toMs"] / minute) for one in found["risky"]] == [
        (5, 9),
        (35, 36),
    ]
    assert found["runs"] == [20, 10]


def test_a_margin_to_a_runaway_is_said_in_words(parts: Page) -> None:
    base = {"speed_rpm": 6200, "load_n": 5500, "probability": 0.021, "margin_k": 24.1}
    margins = [
        base | {"margin_n": 1896.0},
        base | {"margin_n": None, "probability": 0.001},
        base | {"margin_n": -300, "margin_k": None, "probability": 0.12},
        None,
    ]
    said = run(
        parts,
        "const { marginText } = await import('/js/runaway.js'); return margins.map(marginText);",
        margins=margins,
    )
    assert said == [
        "Margin to thermal runaway: 1900 N / 24 K, probability 2 %",
        "Margin to thermal runaway: more than 5500 N / 24 K, probability < 1 %",
        "Margin to thermal runaway: −300 N, probability 12 %",
        "",
    ]
