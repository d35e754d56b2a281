"""What-if, envelope and the engineer's view against the real service with a day's history."""

import csv
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from patience import patience
from playwright.sync_api import (
    BrowserContext,
    ConsoleMessage,
    Locator,
    Page,
    Response,
    Route,
    expect,
)

from adapters.virtual_bench import BenchParameters, Scenario, measure, scenario_profile, simulate
from adapters.virtual_bench.scenarios import BenchPhase
from service.demo.configuration import ASSET
from tests.processes import Site, wait_until

pytestmark = [pytest.mark.browser, pytest.mark.wires, pytest.mark.timeout(300)]

WAIT_MS = 60_000  # on a busy machine a service takes its time
EVERY_S = 20
API = f"/api/v1/assets/{ASSET}"
# speed in rpm, load in N, minutes: two runs in the low-risk region, one beyond it
HISTORY = (
    (0.0, 2650.0, 5), (1500.0, 2650.0, 60), (2400.0, 2650.0, 60), (4200.0, 2650.0, 75),
    (0.0, 2650.0, 60), (5600.0, 2650.0, 45), (0.0, 2650.0, 60), (4200.0, 3300.0, 60),
    (3600.0, 2000.0, 60),
)  # fmt: skip

expect.set_options(timeout=patience(WAIT_MS))


def write_history(path: Path) -> float:
    """What a virtual bench measured over the history; gives its length in s."""
    steps = tuple(
        BenchPhase(f"step {number}", 60.0 * minutes, speed, load, "low")
        for number, (speed, load, minutes) in enumerate(HISTORY)
    )
    parameters = BenchParameters()
    profile = scenario_profile(Scenario("history", "", "6311", steps), parameters, 1)
    seen = measure(profile, simulate(profile, parameters), 1)
    names = ("speed_rpm", "load_n", "ambient_c", "t_inner_ring_c", "t_outer_ring_c")
    columns = [getattr(seen, name)[::EVERY_S] for name in names]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", *names])
        for number, row in enumerate(zip(*columns, strict=True)):
            writer.writerow([number * EVERY_S, *(f"{value:.3f}" for value in row)])
    return float(len(seen.speed_rpm))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A bench that has just been switched on, and a service that has its history."""
    folder = tmp_path_factory.mktemp("site")
    # Process time is wall time here: nothing is identified by itself while the tests run.
    site = Site(folder, "staircase", 1.0)
    text = site.configuration.read_text().replace('ladder = "apply"', 'ladder = "suggest"')
    site.configuration.write_text(text)
    length_s = write_history(folder / "history.csv")
    start = datetime.now(UTC) - timedelta(seconds=length_s + 120)
    command = [
        sys.executable, "-m", "service", "import", str(folder / "history.csv"), "--asset", ASSET,
        "--start", f"{start:%Y-%m-%dT%H:%M:%SZ}", "-c", str(site.configuration), "--json",
    ]  # fmt: skip
    try:
        site.start_bench()
        told = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
        assert told["rejected"] == 0
        site.start_service()
        wait_until(
            lambda: site.client.get(f"{API}/forecast").is_success, WAIT_MS / 1000, "a live forecast"
        )
        yield site
    finally:
        site.close()


@pytest.fixture
def problems() -> list[str]:
    """What the browser complains about; empty at the end of a good test."""
    return []


@pytest.fixture
def open_view(context: BrowserContext, site: Site, problems: list[str]) -> Any:
    """Open a view of the dashboard, logged in as an administrator."""
    context.grant_permissions(["clipboard-read", "clipboard-write"])
    assert context.request.post(
        f"http://127.0.0.1:{site.port}/api/v1/session",
        data={"key": site.key},
    ).ok

    def note(message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            problems.append(message.text)

    def open_it(address: str) -> Page:
        page = context.new_page()
        page.set_default_timeout(WAIT_MS)
        page.on("console", note)
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto(f"http://127.0.0.1:{site.port}/{address}")
        return page

    return open_it


def degrees(text: str) -> float:
    return float(text.split("°")[0].replace("\u2212", "-"))


# ---------------------------------------------------------------------- what-if
def test_what_if_follows_the_hand_and_leaves_as_link_or_file(
    open_view: Any, problems: list[str]
) -> None:
    page = open_view("#whatif")
    peak = page.locator('.ans[aria-label="Peak"] .word')
    expect(peak).to_have_text(re.compile(r"\d"))
    page.get_by_role("button", name="hold").click()
    page.get_by_role("spinbutton", name="Speed, step 1, rpm").fill("1000")
    with page.expect_response(lambda answer: asked(answer, 1000, 7200)):
        page.get_by_role("spinbutton", name="Duration, step 1, min").fill("120")
    page.wait_for_timeout(300)
    slow = degrees(peak.inner_text())
    page.evaluate(
        """() => {
          window.answerMs = [];
          new PerformanceObserver((list) => list.getEntries()
            .filter((entry) => entry.name.endsWith('/forecasts'))
            .forEach((entry) => window.answerMs.push(entry.duration)))
            .observe({ type: 'resource' });
        }"""
    )
    drag(page, page.locator("#step0-speed_rpm"), 0.15, 0.9)
    wait_until(lambda: degrees(peak.inner_text()) > slow + 8, 30, "the answer for a fast machine")
    answers = sorted(page.evaluate("window.answerMs"))
    assert len(answers) > 1, "answers come while the slider moves"
    title = page.locator(".p-trend h2").first
    expect(title).to_have_attribute("title", re.compile(r"Answered in \d+ ms"))

    expect(page.locator(".hint .v")).to_have_text(re.compile(r"^\d+rpm|None|No limit up to \d+rpm"))
    use = page.get_by_role("button", name="Use this speed")
    if use.is_visible():
        highest = re.sub(r"\D", "", page.locator(".hint .v").inner_text())
        use.click()
        speed_box = page.get_by_role("spinbutton", name="Speed, step 1, rpm")
        expect(speed_box).to_have_value(highest)
    page.get_by_role("button", name="Add step").click()
    page.get_by_role("spinbutton", name="Speed, step 2, rpm").fill("2500")
    page.get_by_role("spinbutton", name="Load, step 2, N").fill("-5")
    expect(page.locator(".p-profile .problem")).to_have_text(
        "Step 2, Load: expected 0 to 200000 N."
    )
    page.get_by_role("spinbutton", name="Load, step 2, N").fill("3100")
    expect(page.locator(".p-profile .problem")).to_have_text("")
    page.get_by_role("button", name="Copy link").click()
    expect(page.locator(".note")).to_contain_text("copied")
    link = page.evaluate("navigator.clipboard.readText()")
    assert link == page.url

    with page.expect_download() as download:
        page.get_by_role("button", name="Save as CSV").click()
    rows = list(csv.DictReader(download.value.path().read_text().splitlines()))
    assert list(rows[0]) == ["time_s", "speed_rpm", "load_n", "ambient_c"]
    assert [row["time_s"] for row in rows] == ["0", "7200", "14400"]
    assert [row["speed_rpm"] for row in rows][1:] == ["2500", "2500"]
    assert float(rows[0]["ambient_c"]) == pytest.approx(22, abs=8)

    other = open_view(link.split("/", 3)[3])
    expect(other.get_by_role("spinbutton", name="Speed, step 2, rpm")).to_have_value("2500")
    expect(other.get_by_role("spinbutton", name="Load, step 2, N")).to_have_value("3100")
    expect(other.locator(".hint .v")).to_have_text(re.compile(r"\d+rpm|None"))
    for view in ("Envelope", "What-if"):  # and back again
        other.get_by_role("link", name=view).click()
    expect(other.get_by_role("spinbutton", name="Load, step 2, N")).to_have_value("3100")
    assert problems == []


def asked(answer: Response, speed_rpm: int, duration_s: int) -> bool:
    """Whether this answers a profile that begins so."""
    if not answer.url.endswith("/forecasts"):
        return False
    first = json.loads(answer.request.post_data or "{}")["profile"][0]
    return (first["speed_rpm"], first["duration_s"]) == (speed_rpm, duration_s)


def drag(page: Page, slider: Locator, start: float, end: float) -> None:
    """Move a slider's thumb by hand, from one share of its length to another."""
    box = slider.bounding_box()
    assert box is not None
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + start * box["width"], y)
    page.mouse.down()
    for number in range(31):
        share = start + (end - start) * number / 30
        page.mouse.move(box["x"] + share * box["width"], y)
        page.wait_for_timeout(30)
    page.mouse.up()


# ---------------------------------------------------------------------- envelope
def test_envelope_is_walked_with_the_keyboard(open_view: Any, problems: list[str]) -> None:
    page = open_view("#envelope")
    head = page.locator("#probe h2")
    expect(head).to_have_text(re.compile("rpm"))
    canvas = page.locator(".map canvas")
    canvas.focus()

    def point() -> tuple[int, int]:
        speed, load = re.findall(r"\d+", head.inner_text())
        return int(speed), int(load)

    for _ in range(8):
        canvas.press("Shift+ArrowLeft")
        canvas.press("Shift+ArrowDown")
    canvas.press("Shift+ArrowRight")
    canvas.press("Shift+ArrowUp")
    speed, load = point()
    for key, move in {
        "ArrowRight": (100, 0),
        "ArrowUp": (100, 100),
        "Shift+ArrowRight": (600, 100),
        "Shift+ArrowUp": (600, 600),
        "ArrowLeft": (500, 600),
        "ArrowDown": (500, 500),
    }.items():
        canvas.press(key)
        assert point() == (speed + move[0], load + move[1]), key
    said = page.locator("#probe .kv")
    for row in ("Steady, median", "median time", "Thermal runaway"):
        expect(said).to_contain_text(row)
    assert problems == []


@pytest.mark.thorough
def test_who_leaves_the_envelope_ends_its_study_and_finds_the_last_map_again(
    open_view: Any, problems: list[str]
) -> None:
    page = open_view("#envelope")
    head = page.locator("#probe h2")
    expect(head).to_have_text(re.compile("rpm"))
    age = page.locator(".p-map [role=status]", has_text="Map of")
    expect(age).to_have_text(re.compile(r"^Map of \d\d:\d\d, .* old"))

    held: list[Route] = []
    page.route("**/envelope", lambda route: held.append(route))
    page.get_by_role("link", name="What-if").click()
    expect(page.locator("body")).to_have_attribute("data-view", "whatif")
    page.get_by_role("link", name="Envelope").click()
    expect(head).to_have_text(re.compile("rpm"))  # the map of before, at once
    expect(age).to_contain_text("old. Computing a new one …")
    wait_until(lambda: len(held) == 1, 30, "the next question")
    with page.expect_event("requestfailed", lambda one: one.url.endswith("/envelope")):
        page.get_by_role("link", name="What-if").click()

    page.unroute("**/envelope")
    detail = "busy: five calculations are running with this key"
    page.route(
        "**/envelope",
        lambda route: route.fulfill(
            status=503, content_type="application/problem+json", json={"detail": detail}
        ),
    )
    page.get_by_role("link", name="Envelope").click()
    expect(page.locator(".p-map .problem")).to_have_text(
        "Busy: five calculations are running with this key. Retrying in 15 s."
    )
    expect(head).to_have_text(re.compile("rpm"))
    assert [text for text in problems if "503" not in text] == []


@pytest.mark.thorough
def test_without_trust_in_the_model_nothing_is_foretold(
    context: BrowserContext, open_view: Any, problems: list[str]
) -> None:
    def distrust(route: Route) -> None:
        answer = route.fetch()
        found = answer.json()
        for asset in found.get("items", [found]):
            asset["active_model"]["trusted"] = False
        route.fulfill(response=answer, json=found)

    for end in ("", f"/{ASSET}"):
        context.route(f"**/api/v1/assets{end}", distrust)
    page = open_view("#whatif")
    tiles = page.locator(".ans")
    expect(tiles.locator(".word")).to_have_text(["No forecast"] * 3)
    expect(tiles.first).to_contain_text("the model is not trusted")
    page.goto(page.url.split("#")[0] + "#envelope")
    expect(page.locator("#probe .word")).to_have_text("Not trusted")
    expect(page.locator(".distrust")).to_be_visible()
    assert problems == []


# ---------------------------------------------------------------------- engineer
def test_engineer_chooses_identifies_cancels_compares_activates_and_rolls_back(
    open_view: Any, site: Site, problems: list[str]
) -> None:
    page = open_view("#engineer")
    expect(page.locator(".wtl [data-window]")).to_have_count(2)
    expect(page.locator(".wtl svg")).to_contain_text("high-risk")
    choose_windows(page)
    cancel_a_search(page, site)

    page.get_by_role("button", name="Use all windows").click()
    page.get_by_role("combobox", name="Method").select_option("refine")
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.locator(".e-job h2")).to_have_text("Re-identification, became v2")
    expect(page.locator(".e-job .gates li")).to_have_count(5)
    made = site.get(f"{API}/models/2")
    assert made["status"] == "candidate", made["reason"]
    assert len(made["windows"]) == 2
    assert chart_pixels(page) > 100, "the convergence is drawn"

    versions = page.locator(".e-ver")
    expect(versions.get_by_label("compare")).to_have_value("1")
    expect(versions.get_by_label("with")).to_have_value("2")
    expect(versions.locator("thead").first).to_contain_text("v2 candidate")
    expect(versions.locator(".vt tbody tr", has_text="extrapolation to")).to_have_count(1)
    versions.locator("summary", has_text="Identifiability").click()
    expect(versions.locator("details[open]")).to_contain_text("v2: ")
    expect(page.locator(".e-drift")).to_contain_text("in v2, 95 %")

    page.get_by_role("button", name="Activate v2…").click()
    give_reason(page, "passed its gates", "Activate")
    journal = page.locator(".e-jou")
    expect(journal).to_contain_text("passed its gates")
    assert site.tag("model.version") == 2
    expect(page.locator(".e-adv .adv table").first).to_be_visible()

    page.get_by_role("button", name="Roll back to v1…").click()
    give_reason(page, "only a rehearsal", "Roll back")
    expect(journal).to_contain_text("only a rehearsal")
    assert site.tag("model.version") == 1
    expect(page.get_by_role("button", name=re.compile("Roll back"))).to_be_hidden()
    assert [text for text in problems if "422" not in text] == []


def choose_windows(page: Page) -> None:
    """Leave a window out, try a span beyond the region, and be refused."""
    page.get_by_role("button", name="Select manually").click()
    windows = page.locator(".wtl [data-window]")
    windows.first.click()
    expect(windows.first).to_have_attribute("aria-checked", "false")
    windows.first.focus()
    windows.first.press("Space")
    expect(windows.first).to_have_attribute("aria-checked", "true")
    windows.first.click()
    risky = page.locator(".wtl g", has=page.locator("title", has_text="never used for training"))
    box = risky.first.locator("rect").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] - 5, box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"], box["y"] + 20, steps=4)
    page.mouse.up()
    expect(page.locator(".wtl [data-own]")).to_have_count(1)
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.locator(".e-job .problem")).to_contain_text("outside the low-risk region")
    row = page.locator(".wt tr", has_text="added manually")
    row.get_by_role("button", name="Exclude").click()
    expect(page.locator(".wtl [data-own]")).to_have_count(0)


def cancel_a_search(page: Page, site: Site) -> None:
    """Start a long search on the one window chosen, watch it, and cancel it."""
    page.get_by_role("combobox", name="Method").select_option("noa")
    page.get_by_role("spinbutton", name="Budget in evaluations").fill("5000000")
    page.get_by_role("button", name="Start", exact=True).click()
    panel = page.locator(".e-job")
    expect(panel.locator("header")).to_contain_text("NOA search")
    expect(panel.locator("[role=status]")).to_have_text(re.compile(r"[1-9]\d* of 5000000 eval"))
    assert page.get_by_role("button", name="Start", exact=True).is_disabled()
    panel.get_by_role("button", name="Cancel").click()
    expect(panel.locator("header")).to_contain_text("cancelled")
    [job] = site.get(f"{API}/identifications")["items"]
    assert (job["status"], job["method"], job["budget"]) == ("cancelled", "noa", 5_000_000)
    assert len(job["windows"]) == 1


def give_reason(page: Page, reason: str, action: str) -> None:
    dialog = page.locator("dialog")
    dialog.get_by_role("textbox").fill(reason)
    dialog.get_by_role("button", name=action).click()


def chart_pixels(page: Page) -> int:
    """Pixels of the convergence chart in the twin's blue."""
    count: int = page.evaluate(
        """() => {
          const canvas = document.querySelector('.cv canvas');
          const { data } = canvas.getContext('2d')
            .getImageData(0, 0, canvas.width, canvas.height);
          let count = 0;
          for (let i = 0; i < data.length; i += 4) {
            if (data[i + 2] > data[i] + 60 && data[i + 3] > 200) count += 1;
          }
          return count;
        }"""
    )
    return count


def test_a_version_that_failed_a_gate_is_activated_only_against_it(
    open_view: Any, site: Site, problems: list[str]
) -> None:
    with site.open_store() as store:
        made = store.models.version(ASSET, 2)
        assert made is not None
        gates = made.document["gates"]
        checks = [*gates["checks"][:-1], gates["checks"][-1] | {"passed": False, "detail": "loses"}]
        document = made.document | {"gates": gates | {"accepted": False, "checks": checks}}
        store.models.add(ASSET, "rejected", "loses", document, made.created_at_us + 1)
    page = open_view("#engineer")
    verdict = page.locator(".e-ver .act")
    expect(verdict).to_contain_text("v3 is stored, not offered: 4 of 5 gates passed. loses.")
    expect(page.get_by_role("button", name="Activate v3…")).to_be_disabled()
    page.get_by_role("button", name="Activate despite failed gates…").click()
    give_reason(page, "known better", "Activate despite failed gates")
    expect(page.locator(".e-jou")).to_contain_text("known better")
    assert site.tag("model.version") == 3
    assert problems == []
