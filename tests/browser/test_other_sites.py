"""Another site, in a real browser: it changes nothing here, and logs nobody in."""

import base64
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from tests.browser.plant import Plant

pytestmark = pytest.mark.browser

REFUSED = 403


@contextmanager
def other_site(page: str) -> Iterator[str]:
    """Serve one page from another site: the plant is on 127.0.0.1, this is on localhost."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            body = page.encode()
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            """Keep the test's output clean."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://localhost:{server.server_address[1]}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def session_of(context: BrowserContext, plant: Plant) -> dict[str, Any] | None:
    """Who the browser is logged in as, asked with its cookies."""
    answer = context.request.get(f"{plant.address}/api/v1/session")
    found: dict[str, Any] | None = answer.json() if answer.ok else None
    return found


def changes(plant: Plant) -> list[dict[str, object]]:
    """The lines of the audit trail, but for logins: several of these become one line later."""
    items = plant.client.get("/api/v1/audit").json()["items"]
    return [one for one in items if not one["action"].startswith("session.")]


@pytest.mark.parametrize("credential", ["basic", "cookie"])
def test_a_form_of_another_site_changes_nothing(
    browser: Browser, plant: Plant, credential: str
) -> None:
    made = plant.client.post("/api/v1/keys", json={"role": "admin"}).json()
    headers = {}
    if credential == "basic":  # as a browser sends that has once been given the password
        password = base64.b64encode(f"any:{made['key']}".encode()).decode()
        headers["Authorization"] = f"Basic {password}"
    context = browser.new_context(extra_http_headers=headers)
    try:
        page = context.new_page()
        if credential == "cookie":
            page.goto(f"{plant.address}/#key={made['key']}")
            page.locator("nav.tabs a[aria-current]").wait_for()
        target = f"{plant.address}/api/v1/assets/press-1/models/1/activate"
        form = f'<form method="post" action="{target}"></form>'
        form += "<script>document.forms[0].submit()</script>"
        before = changes(plant)
        with other_site(form) as site, page.expect_response(target) as sent:
            page.goto(site)
        # Without its cookie, which a browser keeps back, the form is nobody's.
        assert sent.value.status == (REFUSED if credential == "basic" else 401)
        assert sent.value.request.method == "POST"
        assert changes(plant) == before
    finally:
        context.close()


@pytest.mark.thorough
def test_a_browser_asks_for_no_password(context: BrowserContext, plant: Plant) -> None:
    answer = context.new_page().goto(f"{plant.address}/api/v1/assets")
    assert answer is not None
    assert answer.status == 401
    assert "basic" not in answer.headers["www-authenticate"].lower()


@pytest.mark.thorough
@pytest.mark.parametrize("by", ["script", "link without referrer"])
def test_a_link_of_another_site_logs_nobody_in_unasked(
    context: BrowserContext, plant: Plant, by: str
) -> None:
    made = plant.client.post("/api/v1/keys", json={"role": "operator"}).json()
    link = f"{plant.address}/#key={made['key']}"
    script = f"<script>location.href = {link!r}</script>"
    anchor = f'<a rel="noreferrer" href="{link}">Free coffee</a>'
    page = context.new_page()
    with other_site(script if by == "script" else anchor) as site:
        page.goto(site)
        if by != "script":
            page.get_by_text("Free coffee").click()
        expect(page.get_by_text("This link contains the key")).to_contain_text(made["prefix"])
    assert made["key"] not in page.url
    assert session_of(context, plant) is None
    page.get_by_role("button", name="Log in").click()  # its user knows the link
    expect(page.locator("nav.tabs a[aria-current]")).to_have_text("Fleet")
    found = session_of(context, plant)
    assert found is not None
    assert found["prefix"] == made["prefix"]


@pytest.mark.thorough
def test_no_link_replaces_the_session_that_there_is(
    context: BrowserContext, plant: Plant, screen: Callable[..., Page]
) -> None:
    page = screen("operator/press-1", "viewer")
    before = session_of(context, plant)
    made = plant.client.post("/api/v1/keys", json={"role": "admin"}).json()
    link = f"{plant.address}/#key={made['key']}"
    with other_site(f"<script>location.href = {link!r}</script>") as site:
        page.goto(site)
        expect(page.locator("nav.tabs a[aria-current]")).to_be_visible()
    assert session_of(context, plant) == before
    page.goto("about:blank")
    page.goto(link)  # not even by hand: who logs in as somebody else logs out before
    expect(page.locator("nav.tabs a[aria-current]")).to_be_visible()
    assert session_of(context, plant) == before
