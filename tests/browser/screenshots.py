"""Pictures of every view of a running service, to be looked at: desk, wall, tablet and phone.

``python -m tests.browser.screenshots ADDRESS KEY FOLDER [VIEW ...]``, for instance of a
``bearing-twin demo --port 8080 --headless``, which prints address and key.
"""

import sys
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

from tests.browser.conftest import CHROMIUM

VIEWS = ("operator", "whatif", "envelope", "engineer", "history", "alarms")
SIZES = {
    "desk": (1251, 900),
    "wall": (1920, 1080),
    "uhd": (3840, 2160),
    "tablet": (820, 1180),
    "phone": (390, 844),
}
SETTLE_MS = 3500


def shoot(browser: Browser, address: str, key: str, folder: Path, views: list[str]) -> None:
    """Take every view in both themes and all sizes; what the browser complains about is printed."""
    for size, (width, height) in SIZES.items():
        touch = width < 1000
        for theme in ("dark", "light"):
            context = browser.new_context(
                viewport={"width": width, "height": height},
                locale="en-GB",
                timezone_id="Europe/Berlin",
                has_touch=touch,
                device_scale_factor=2 if size == "phone" else 1,
            )
            context.add_init_script(f"localStorage.setItem('theme', '{theme}')")
            page = context.new_page()
            page.on("pageerror", lambda error: sys.stderr.write(f"page error: {error}\n"))
            page.goto(f"{address}/#key={key}")
            page.locator("nav.tabs a[aria-current]").wait_for()
            for view in views:
                page.goto(f"{address}/#{view}")
                page.wait_for_timeout(SETTLE_MS)
                name = view.replace("/", "-")
                page.screenshot(path=folder / f"{name}-{size}-{theme}.png")
            context.close()


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    target, secret, out, *wanted = sys.argv[1:]
    Path(out).mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        shoot(chromium, target, secret, Path(out), wanted or list(VIEWS))
        chromium.close()
