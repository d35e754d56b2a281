"""Pictures of every view of a running service, to be looked at: desk, wall, tablet and phone.

``python -m tests.browser.screenshots ADDRESS KEY FOLDER [NAME ...]``, for instance of a
``bearing-twin demo --port 8080``, which prints address and key. Names of views, sizes and themes
restrict what is taken: ``operator whatif wall dark``. ``login`` is the page without a key,
``offline`` the operator's when the service no longer answers.
"""

import sys
from collections.abc import Collection
from pathlib import Path

from playwright.sync_api import (
    Browser,
    BrowserContext,
    Error,
    Page,
    WebSocketRoute,
    sync_playwright,
)

from tests.programs import path_of

VIEWS = (
    "login",
    "fleet",
    "operator",
    "whatif",
    "envelope",
    "engineer",
    "history",
    "accuracy",
    "alarms",
    "assets",
    "offline",
)
SIZES = {
    "desk": (1440, 900),
    "wall": (1920, 1080),
    "uhd": (3840, 2160),
    "tablet": (1024, 768),
    "phone": (390, 844),
}
THEMES = ("dark", "light")
SETTLE_MS = 3500


def shoot(browser: Browser, address: str, key: str, folder: Path, names: Collection[str]) -> None:
    """Take the pictures; what the browser complains about is printed."""

    def chosen(all_names: Collection[str]) -> list[str]:
        return [name for name in all_names if name in names] or list(all_names)

    for size in chosen(SIZES):
        for theme in chosen(THEMES):
            context = _context(browser, size, theme)
            lines: list[WebSocketRoute] = []
            page = _page(context, lines)
            for view in chosen(VIEWS):
                if view == "login":
                    page.goto(address)
                    page.get_by_label("Access key").wait_for()
                else:
                    _open(page, address, key, "operator" if view == "offline" else view)
                if view == "offline":
                    context.set_offline(True)
                    for line in lines:
                        line.close()
                    page.locator("#lost:not(:empty)").wait_for()
                page.wait_for_timeout(SETTLE_MS)
                page.screenshot(
                    path=folder / f"{view}-{size}-{theme}.png",
                    full_page=view != "offline" and SIZES[size][0] < 1500,
                )
            context.close()


def _context(browser: Browser, size: str, theme: str) -> BrowserContext:
    width, height = SIZES[size]
    context = browser.new_context(
        viewport={"width": width, "height": height},
        locale="en-GB",
        timezone_id="Europe/Berlin",
        has_touch=size in ("tablet", "phone"),
        device_scale_factor=2 if size == "phone" else 1,
    )
    context.add_init_script(f"localStorage.setItem('theme', '{theme}')")
    return context


def _page(context: BrowserContext, lines: list[WebSocketRoute]) -> Page:
    """A page whose lines to the service can be cut."""

    def through(line: WebSocketRoute) -> None:
        line.connect_to_server()
        lines.append(line)

    page = context.new_page()
    page.route_web_socket("**/*", through)

    def report(error: Error) -> None:
        sys.stderr.write(f"page error: {error}\n")

    page.on("pageerror", report)
    return page


def _open(page: Page, address: str, key: str, view: str) -> None:
    tabs = page.locator("nav.tabs a[aria-current]")
    if not tabs.count():
        # Elsewhere first: from the login form, a new hash alone would load nothing.
        page.goto(f"{address}/favicon.svg")
        page.goto(f"{address}/#key={key}")
        tabs.wait_for()
    page.goto(f"{address}/#{view}")


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    target, secret, out, *wanted = sys.argv[1:]
    Path(out).mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=path_of("chromium", "chromium-browser"), args=["--no-sandbox"]
        )
        shoot(chromium, target, secret, Path(out), wanted)
        chromium.close()
