"""Logging in and out, and what becomes of a page whose key is no longer valid."""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import BrowserContext, Page, expect

from tests.browser.plant import Plant

pytestmark = pytest.mark.browser


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


def test_a_revoked_key_ends_the_session_and_says_why(context: BrowserContext, plant: Plant) -> None:
    made = plant.client.post("/api/v1/keys", json={"role": "operator"}).json()
    page = context.new_page()
    page.goto(f"{plant.address}/#key={made['key']}")
    expect(page.locator("nav.tabs a[aria-current]")).to_have_text("Fleet")
    assert plant.client.delete(f"/api/v1/keys/{made['id']}").is_success
    expect(page.locator(".login .problem")).to_have_text(re.compile("no longer valid"))


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
