"""Makes the pictures of README and docs from the demo: ``python -m tools.pictures``.

The demo runs at its usual rate, which takes five minutes. What an operator sees is taken before
the heaviest stage; what has collected by then, after the last one. Chromium must be installed and
the machine idle: on a busy one the pictures show sources that sent nothing. Look at each.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

from tests.browser.screenshots import shoot
from tests.programs import path_of

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
#: Which views are taken so many seconds after a line of the demo has this in it.
MOMENTS = {
    "Stage 8 of 10": (20.0, ("operator", "whatif")),
    "The page stays up": (0.0, ("engineer", "envelope", "history", "accuracy", "alarms")),
}
_ADDRESS = re.compile(r"Open (http://\S+)/#key=(\S+)")


def take(browser: Browser, address: str, key: str, views: Collection[str]) -> None:
    """Put a picture of each view into the folder of the docs."""
    with tempfile.TemporaryDirectory() as folder:
        shoot(browser, address, key, Path(folder), [*views, "desk", "dark"])
        for view in views:
            shutil.copyfile(Path(folder) / f"{view}-desk-dark.png", IMAGES / f"{view}.png")
            sys.stderr.write(f"docs/images/{view}.png\n")


def follow(browser: Browser, demo: "subprocess.Popen[str]") -> set[str]:
    """Take the pictures at their moments; gives the moments that came."""
    came: set[str] = set()
    address = key = ""
    for line in demo.stdout or ():
        sys.stderr.write(line)
        if found := _ADDRESS.search(line):
            address, key = found.groups()
        for moment in MOMENTS.keys() - came:
            if moment in line:
                delay_s, views = MOMENTS[moment]
                time.sleep(delay_s)
                take(browser, address, key, views)
                came.add(moment)
        if came == MOMENTS.keys():
            break
    return came


def main() -> None:
    """Run the demo and take the pictures."""
    command = [sys.executable, "-m", "service", "demo", "--port", "0", "--stay", *sys.argv[1:]]
    with (
        sync_playwright() as playwright,
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as demo,
    ):
        path = path_of("chromium", "chromium-browser", "chromium-headless-shell")
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        try:
            came = follow(browser, demo)
        finally:
            browser.close()
            demo.terminate()
    if missing := MOMENTS.keys() - came:
        raise SystemExit(f"the demo ended without {', '.join(sorted(missing))}")


if __name__ == "__main__":
    main()
