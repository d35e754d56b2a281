"""A real browser for the dashboard: Debian's Chromium, driven by Playwright."""

import threading
from collections.abc import Callable, Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest
from patience import patience
from playwright.sync_api import (
    Browser,
    BrowserContext,
    ConsoleMessage,
    Page,
    expect,
    sync_playwright,
)
from programs import needed

from service.web.pages import static_directory
from tests.browser.plant import Plant

WAIT_MS = 60_000  # on a busy machine a service takes its time

expect.set_options(timeout=patience(WAIT_MS))


# Per module, not per session: Playwright's event loop must be gone before asynchronous tests run.
@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    # Without a window it takes a fifth less processor time.
    path = needed("chromium", "chromium-headless-shell", "chromium", "chromium-browser")
    with sync_playwright() as playwright:
        # The sandbox needs kernel rights that a container seldom has; the pages are our own.
        chromium = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    context = browser.new_context(
        viewport={"width": 1280, "height": 900}, locale="en-GB", timezone_id="Europe/Berlin"
    )
    yield context
    context.close()


class _QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Keep the test's output clean."""


@pytest.fixture(scope="session")
def static_address() -> Iterator[str]:
    """The dashboard's files alone, for tests of its parts."""
    handler = partial(_QuietHandler, directory=str(static_directory()))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def parts(context: BrowserContext, static_address: str) -> Page:
    """A plain page of the dashboard's origin, from which its modules can be imported."""
    page = context.new_page()
    page.goto(f"{static_address}/vendor/NOTICE.txt")
    return page


@pytest.fixture(scope="package")
def started_plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    """One service for all views: starting it takes longer than looking at it."""
    with Plant(tmp_path_factory.mktemp("plant")) as plant:
        plant.start()
        yield plant


@pytest.fixture
def plant(started_plant: Plant) -> Plant:
    """The plant with harmless values; what a test before did to it is over."""
    started_plant.calm()
    return started_plant


@pytest.fixture
def problems() -> list[str]:
    """What the browser complains about; empty at the end of a good test."""
    return []


@pytest.fixture
def screen(context: BrowserContext, plant: Plant, problems: list[str]) -> Callable[..., Page]:
    """Open a view of the dashboard, logged in with a role."""

    def note(message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            problems.append(message.text)

    def open_view(view: str, role: str = "admin") -> Page:
        page = context.new_page()
        page.set_default_timeout(WAIT_MS)
        page.on("console", note)
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto(f"{plant.address}/#key={plant.key_of(role)}")
        page.locator("nav.tabs a[aria-current]").wait_for()
        page.goto(f"{plant.address}/#{view}")
        return page

    return open_view
