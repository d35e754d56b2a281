"""Logging in and out, and what becomes of a page whose key is no longer valid."""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import BrowserContext, Page, expect

from tests.browser.plant import BEARING, GEARBOX, Plant
from tests.processes import wait_until

pytestmark = pytest.mark.browser

#: The list of assets is refused, and then the service does not say whether the session is over.
REFUSED_ONCE = """() => {
  const ask = window.fetch;
  let refused = false, asked = false;
  window.fetch = async (path, options) => {
    if (!refused && path.startsWith('/api/v1/assets')) {
      refused = true;
      return new Response('{}', { status: 401 });
    }
    if (refused && !asked && path === '/api/v1/session') {
      asked = true;
      throw new TypeError('Failed to fetch');
    }
    return ask(path, options);
  };
}"""


def test_a_wrong_key_is_told_and_the_right_one_lets_in(
    context: BrowserContext, plant: Plant
) -> None:
    page = context.new_page()
    page.goto(plant.address)
    key = page.get_by_label("Access key")
    key.fill("bt_00000000_wrong")
    key.press("Enter")
    expect(page.locator(".login .problem")).to_have_text(re.compile("not known"))
    expect(page.locator("nav.tabs a")).to_have_count(0)
    key.fill(plant.key_of("operator"))
    key.press("Enter")
    expect(page.locator("nav.tabs a[aria-current]")).to_have_text("Fleet")
    page.locator(".menu summary").click()
    page.get_by_role("button", name="Log out").click()
    expect(page.get_by_label("Access key")).to_be_visible()
    page.reload()
    expect(page.get_by_label("Access key")).to_be_visible()


def test_a_refusal_that_cannot_be_explained_leaves_no_empty_page(
    context: BrowserContext, plant: Plant
) -> None:
    page = context.new_page()
    page.goto(plant.address)
    page.evaluate(REFUSED_ONCE)
    page.get_by_label("Access key").fill(plant.key_of("operator"))
    page.keyboard.press("Enter")
    expect(page.locator("#main")).to_contain_text("your session has ended. Retrying")
    expect(page.locator("nav.tabs a[aria-current]")).to_have_text("Fleet")


@pytest.mark.thorough
def test_a_revoked_key_ends_the_session_and_says_why(context: BrowserContext, plant: Plant) -> None:
    made = plant.client.post("/api/v1/keys", json={"role": "operator"}).json()
    page = context.new_page()
    page.goto(f"{plant.address}/#key={made['key']}")
    expect(page.locator("nav.tabs a[aria-current]")).to_have_text("Fleet")
    assert plant.client.delete(f"/api/v1/keys/{made['id']}").is_success
    expect(page.locator(".login .problem")).to_have_text(re.compile("no longer valid"))


@pytest.mark.parametrize("role", ["operator", "viewer"])
def test_what_was_entered_outlives_the_session_of_the_same_role(
    context: BrowserContext, plant: Plant, role: str
) -> None:
    made = plant.client.post("/api/v1/keys", json={"role": "operator"}).json()
    page = context.new_page()
    page.goto(f"{plant.address}/#key={made['key']}")
    page.locator("nav.tabs a[aria-current]").wait_for()
    page.goto(f"{plant.address}/#alarms/{BEARING}")
    page.get_by_role("button", name="Silence…").click()
    reason = page.get_by_label("Reason")
    reason.fill("Test of the sensors")
    assert plant.client.delete(f"/api/v1/keys/{made['id']}").is_success
    log_in = page.get_by_role("dialog", name="Log in")
    expect(log_in).to_contain_text("Log in with a key of the role operator to keep your input")
    expect(page.locator("#lost")).to_contain_text("Session ended")
    # Alarms that come meanwhile, also of assets that are not looked at, are there afterwards.
    plant.values[GEARBOX]["t_bearing_c"] = 97.0
    wait_until(lambda: plant.alarm("measured limit", GEARBOX), 60, "an alarm of the other machine")
    for _ in range(3):
        page.keyboard.press("Escape")
    expect(log_in).to_be_visible()
    log_in.get_by_label("Access key").fill(plant.key_of(role))
    log_in.get_by_role("button", name="Log in").click()
    expect(log_in).to_have_count(0)
    expect(page.locator("nav.tabs a[aria-current]")).to_have_text("Alarms")
    expect(page.locator("#lost")).to_be_empty()
    expect(page.locator(".al", has_text="over alarm 95")).to_be_visible()
    if role == "viewer":
        expect(page.get_by_role("dialog")).to_have_count(0)
        return
    expect(reason).to_have_value("Test of the sensors")
    expect(page.locator("body")).not_to_have_class(re.compile("offline"))
    page.get_by_role("spinbutton", name="Duration").fill("15")
    page.get_by_role("dialog").get_by_role("button", name="Silence").click()
    expect(page.locator("main")).to_contain_text("Test of the sensors")
    silences = plant.get("/silences")["items"]
    assert [one["comment"] for one in silences] == ["Test of the sensors"]
    for one in silences:
        assert plant.client.delete(f"/api/v1/silences/{one['id']}").is_success


@pytest.mark.thorough
def test_a_call_without_a_session_leads_to_the_login_and_back(
    screen: Callable[..., Page], plant: Plant
) -> None:
    """The stream still runs: only the refused call shows that the session is over."""
    page = screen(f"alarms/{BEARING}", "operator")
    expect(page.locator(".p-journal tbody tr").first).to_be_visible()
    page.context.clear_cookies()
    page.get_by_label("Time range").select_option("last 24 h")
    expect(page.locator(".login .problem")).to_have_text(re.compile("session has ended"))
    expect(page.get_by_text("X-API-Key")).to_have_count(0)
    page.get_by_label("Access key").fill(plant.key_of("operator"))
    page.get_by_role("button", name="Log in").click()
    expect(page.locator("nav.tabs a[aria-current]")).to_have_text("Alarms")
    expect(page).to_have_url(re.compile(rf"#alarms/{BEARING}$"))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("link", "text"),
    [
        (
            "operator/bench-of-old",
            "Unknown asset “bench-of-old”. It may have been renamed or removed.",
        ),
        ("history/%E0%A4%A", "Unknown asset “%E0%A4%A”."),
        ("nosuchview", "Unknown view “nosuchview”."),
        ("toString/press-1", "Unknown view “toString”."),
    ],
)
def test_a_link_that_leads_nowhere_shows_nothing_else(
    screen: Callable[..., Page], problems: list[str], link: str, text: str
) -> None:
    page = screen("fleet", "viewer")
    page.goto(page.url.split("#")[0] + f"#{link}")
    expect(page.locator("main")).to_contain_text(text)
    expect(page.locator(".ans, .card, table")).to_have_count(0)
    expect(page.get_by_label("Asset", exact=True)).to_have_count(0)
    expect(page).to_have_title(re.compile("Not found"))
    page.get_by_role("link", name="All assets").click()
    expect(page.locator(".card").first).to_be_visible()
    assert problems == []


@pytest.mark.thorough
def test_a_viewer_is_told_why_a_control_is_off(screen: Callable[..., Page]) -> None:
    page = screen("operator/press-1", "viewer")
    refused = page.locator("nav.tabs a[aria-disabled]")
    expect(refused).to_have_text(["What-if", "Engineer"])
    for tab, role in zip(refused.all(), ("operator", "engineer"), strict=True):
        expect(tab).to_have_attribute(
            "title", f"Needs the role {role}; you are logged in as viewer."
        )
    page.goto(page.url.split("#")[0] + "#engineer")
    expect(page.locator(".note")).to_contain_text("Needs the role engineer")
    expect(page.locator("nav.tabs a[aria-current]")).to_have_text("Operator")
