"""The dashboard against the real service, fed by the virtual bench over real wires."""

import re
from collections.abc import Iterator

import pytest
from patience import patience
from playwright.sync_api import BrowserContext, ConsoleMessage, Page, Response, expect

from service.security.keys import create_key
from tests.processes import Site, wait_until

pytestmark = [pytest.mark.browser, pytest.mark.wires, pytest.mark.thorough]

RATE = 60.0
WAIT_MS = 60_000  # on a busy machine a service takes its time to start
# What the browser itself says of a connection that broke off, whatever was on its way.
#: What the browser logs of a service that is gone, or that starts and answers 503.
BROKEN = r"WebSocket|ERR_CONNECTION|ERR_INCOMPLETE_CHUNKED_ENCODING|status of 503"

expect.set_options(timeout=patience(WAIT_MS))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with Site(tmp_path_factory.mktemp("site"), "staircase", RATE) as site:
        site.start_bench()
        site.start_service()
        wait_until(
            lambda: site.client.get("/api/v1/assets/bench-1/forecast").is_success,
            60,
            "a live forecast",
        )
        yield site


@pytest.fixture
def page(context: BrowserContext, site: Site, problems: list[str]) -> Page:
    """The operator view, logged in with the key in the address."""
    page = context.new_page()
    page.set_default_timeout(WAIT_MS)

    def note(message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            problems.append(message.text)

    page.on("console", note)
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto(f"http://127.0.0.1:{site.port}/#key={site.key}")
    expect(page.locator(".ans .word").first).to_have_text(re.compile("Safe"))
    return page


def figure(page: Page, node: int) -> str:
    """Temperature that the section shows at a node."""
    text = page.locator(f'[data-figure="{node}"]').text_content()
    assert text is not None
    return text


def fan_pixels(page: Page) -> int:
    """Bluish pixels of the temperature chart: twin and forecast, and nothing else, are blue."""
    count: int = page.evaluate(
        """() => {
          const canvas = document.querySelector('.plot.t canvas');
          if (!canvas) return 0;
          const half = Math.floor(canvas.width * 0.55);
          const copy = new OffscreenCanvas(canvas.width, canvas.height)
            .getContext('2d', { willReadFrequently: true });
          copy.drawImage(canvas, 0, 0);
          const { data } = copy.getImageData(half, 0, canvas.width - half, canvas.height);
          let count = 0;
          for (let i = 0; i < data.length; i += 4) {
            if (data[i + 2] > data[i] + 35 && data[i + 3] > 200) count += 1;
          }
          return count;
        }"""
    )
    return count


def test_the_key_leaves_the_address_and_a_session_stays(page: Page, problems: list[str]) -> None:
    assert "key" not in page.url
    page.reload()
    expect(page.locator(".ans .word").first).to_have_text(re.compile("Safe"))
    assert page.evaluate("document.cookie") == "", "the session must be closed to scripts"
    assert problems == []


def test_live_values_move(page: Page, problems: list[str]) -> None:
    measured, estimated, times = set(), set(), set()
    # What the section shows of bodies without a sensor: not each of them is known by now.
    others = page.locator("[data-figure].es")

    def moved() -> bool:
        measured.add(figure(page, 4))
        estimated.update(others.all_text_contents())
        times.add(page.locator(".clock").inner_text())
        return min(len(measured), len(estimated), len(times)) > 2

    wait_until(moved, 60, "measured values, estimates and times that change")
    assert f"×{RATE:g}" in page.locator(".clock").inner_text()
    assert problems == []


def test_before_the_first_identification_nothing_looks_like_a_forecast(
    page: Page, problems: list[str]
) -> None:
    for label in ("Is the next step safe", "Time to limit"):
        tile = page.locator(f'.ans[aria-label="{label}"]')
        # The bench has only begun: nothing has been identified, and the forecast is the prior's.
        expect(tile.locator(".word")).to_have_text("Unknown")
        expect(tile).to_contain_text("the model was never identified")
    expect(page.locator(".ans h2").nth(1)).to_have_text(re.compile("Next step in"))
    expect(page.locator(".p-trend header")).to_contain_text("never identified: no forecast")
    assert fan_pixels(page) < 2000
    assert problems == []


def test_what_if_answers_and_follows_the_sliders(page: Page, problems: list[str]) -> None:
    page.goto(page.url.split("#")[0] + "#whatif")
    peak = page.locator('.ans[aria-label="Peak"] .word')
    expect(peak).to_have_text(re.compile(r"\d"))
    page.get_by_role("button", name="hold").click()
    duration = page.get_by_role("spinbutton", name="Duration, step 1, min")
    duration.fill("240")

    def answers(response: Response, speed_rpm: int) -> bool:
        body = response.request.post_data or ""
        return response.url.endswith("/forecasts") and f'"speed_rpm":{speed_rpm},' in body

    def peak_at(speed_rpm: int) -> float:
        with page.expect_response(lambda response: answers(response, speed_rpm)) as answer:
            page.get_by_role("spinbutton", name="Speed, step 1, rpm").fill(str(speed_rpm))
        assert answer.value.ok
        page.wait_for_timeout(300)
        return float(peak.inner_text().split("°")[0].replace("\u2212", "-"))

    slow, fast = peak_at(500), peak_at(6200)
    assert fast > slow + 10
    assert problems == []


def test_envelope_is_drawn_and_asked_about(page: Page, problems: list[str]) -> None:
    page.goto(page.url.split("#")[0] + "#envelope")
    point = page.locator("#probe")
    # By the rule of the verdict: the words of a model that was never identified are none.
    expect(point.locator(".word")).to_have_text("Unknown")
    expect(point).to_contain_text("the model was never identified")
    canvas = page.locator(".map canvas")
    colours = canvas.evaluate(
        """(canvas) => {
          const { data } = canvas.getContext('2d')
            .getImageData(0, 0, canvas.width, canvas.height);
          const seen = new Set();
          for (let i = 0; i < data.length; i += 4) seen.add(data[i] << 16 | data[i + 1] << 8);
          return seen.size;
        }"""
    )
    assert colours > 20, "ground, regions, contours and text have colours of their own"

    def steady() -> float:
        return float(point.locator("dd").first.inner_text().split("°")[0])

    head = point.locator("h2")
    canvas.focus()
    for _ in range(20):
        canvas.press("Shift+ArrowLeft")
        canvas.press("Shift+ArrowDown")
    slow, cool = head.inner_text(), steady()
    for _ in range(20):
        canvas.press("Shift+ArrowRight")
        canvas.press("Shift+ArrowUp")
    assert head.inner_text() != slow
    assert steady() > cool + 10
    page.get_by_role("button", name=re.compile("^time to")).click()
    expect(page.get_by_role("button", name=re.compile("^time to"))).to_have_attribute(
        "aria-pressed", "true"
    )
    page.get_by_role("button", name="Try in what-if").click()
    expect(page.get_by_role("spinbutton", name="Speed, step 1, rpm")).to_have_value("7000")
    assert problems == []


def test_a_point_of_the_envelope_can_be_asked_about(page: Page, problems: list[str]) -> None:
    """Before the first identification the answer is that there is nothing to improve yet."""
    page.goto(page.url.split("#")[0] + "#envelope")
    page.get_by_role("button", name="Reduce uncertainty here").click()
    answered = page.locator(".e-adv .problem:not(:empty), .adv table").first
    expect(answered).to_be_visible()
    if answered.evaluate("(element) => element.className") == "problem":
        expect(answered).to_contain_text("no identified model yet")
    else:
        expect(page.locator(".adv").first).to_contain_text("Low-risk step")
    # the browser itself notes a refusal, nothing else is wrong
    assert [text for text in problems if "409" not in text] == []


def test_engineer_sees_windows_jobs_and_versions(page: Page, problems: list[str]) -> None:
    page.goto(page.url.split("#")[0] + "#engineer")
    expect(page.locator(".e-jou .chip.on").first).to_have_text("active")
    expect(page.locator(".vt tbody tr").first).to_be_visible()
    assert page.locator(".vt tbody tr").count() >= 15
    assert problems == []


def test_a_viewer_sees_everything_and_changes_nothing(
    context: BrowserContext, site: Site, problems: list[str]
) -> None:
    with site.open_store() as store:
        key = create_key(store, "viewer").text
    page = context.new_page()
    page.goto(f"http://127.0.0.1:{site.port}/#key={key}")
    expect(page.locator(".ans .word").first).to_have_text(re.compile("Safe"))
    tabs = page.locator("nav.tabs a[href]").all_inner_texts()
    assert tabs == ["Operator", "Envelope", "History", "Accuracy", "Alarms"]
    refused = page.locator("nav.tabs a[aria-disabled]", has_text="Engineer")
    expect(refused).to_have_attribute("title", re.compile("role engineer; you are .* viewer"))


def test_lost_bench_shows_as_unknown_and_its_alarm_is_acknowledged(
    page: Page, site: Site, problems: list[str]
) -> None:
    assert site.bench is not None
    site.bench.kill()
    expect(page.locator("#lost")).to_contain_text("No temperature")
    expect(page.locator('.ans[aria-label="Is it safe now"] .word')).to_have_text("Unknown")
    expect(page.locator('[data-figure="4"]')).to_have_class(re.compile(r"\bst\b"))
    row = page.locator(".al[data-state=UNACK]", has_text="No data from pt100 (")
    expect(row).to_be_visible()
    alarm_id = row.get_attribute("data-alarm")
    row.get_by_role("button", name=re.compile("Acknowledge")).click()
    acknowledged = page.locator(f'.al[data-alarm="{alarm_id}"]')
    expect(acknowledged).to_contain_text("ACKNOWLEDGED")
    expect(acknowledged).to_have_attribute("data-state", "ACKED")
    states = {alarm["id"]: alarm["state"] for alarm in site.get("/api/v1/alarms")["items"]}
    assert states[alarm_id] == "ACKED"
    assert problems == []

    site.start_bench()
    expect(page.locator("#lost")).to_be_empty()
    expect(page.locator('.ans[aria-label="Is it safe now"] .word')).to_have_text(re.compile("Safe"))


def test_service_offline_is_said_and_the_page_comes_back(
    page: Page, site: Site, problems: list[str]
) -> None:
    assert site.service is not None
    words = page.locator(".ans .word")
    expect(words.first).to_have_text(re.compile("Safe"))
    assert problems == []
    site.service.kill()
    expect(page.locator("#lost")).to_contain_text("Connection lost")
    expect(words).to_have_text(["Unknown", "Unknown", "Unknown"])
    expect(page.locator(".clock")).to_have_text(re.compile("old"))
    expect(page.locator('[data-figure="4"]')).to_have_class(re.compile(r"\bst\b"))
    assert page.locator(".al button:enabled:visible").count() == 0

    site.start_service()
    expect(page.locator("#lost")).to_be_empty()
    expect(words.first).to_have_text(re.compile("Safe"))
    before = page.locator(".clock").inner_text()
    wait_until(lambda: page.locator(".clock").inner_text() != before, 30, "a clock that runs")
    # Only the broken connection itself may have been complained about, not by the page.
    assert [text for text in problems if not re.search(BROKEN, text)] == []
