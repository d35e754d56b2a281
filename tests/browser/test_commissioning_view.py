"""A newcomer's own bench: from an empty service to live values, by what a person can see alone."""

import os
import re
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from importlib.resources import files
from pathlib import Path

import httpx2
import pytest
from playwright.sync_api import Browser, BrowserContext, Dialog, Page, expect
from processes import Command, free_port, wait_until
from strange_bench import (
    AMBIENT_C,
    DBC,
    FIRST_REGISTER,
    INNER_C,
    LOAD_N,
    OUTER_C,
    SPEED_RPM,
    UNIT,
    StrangeBench,
    running_strange_bench,
)

from tests.browser.conftest import WAIT_MS
from tests.browser.test_page_quality import violations_in_all_sizes

pytestmark = [pytest.mark.browser, pytest.mark.wires, pytest.mark.timeout(600)]

PHONE = {"width": 390, "height": 844}
#: The figure of the product: so long may a newcomer take, who reads and types more slowly.
WITHIN_S = 15 * 60
SHOTS = os.environ.get("COMMISSIONING_SHOTS", "")


@pytest.fixture(scope="module")
def bench() -> Iterator[StrangeBench]:
    with running_strange_bench() as bench:
        yield bench


class EmptyService:
    """A service whose configuration file is not there yet, started as its user starts it."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "bench.toml"
        self.port = free_port()
        # The port of a test must be free; a newcomer has the usual one.
        environment = {"BEARING_TWIN__SERVICE__PORT": str(self.port)}
        made = subprocess.run(
            [sys.executable, "-m", "service", "keys", "create", "--role", "admin", "-c", self.file],
            env=os.environ | environment,
            check=True,
            capture_output=True,
            text=True,
        )
        self.key = made.stdout.strip()
        self.command = Command(
            ["serve", "-c", str(self.file)],
            folder / "serve.log",
            under=["env", *(f"{name}={value}" for name, value in environment.items())],
        )

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def tables(self) -> dict[str, list[dict[str, object]]]:
        return tomllib.loads(self.file.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmptyService]:
    service = EmptyService(tmp_path_factory.mktemp("empty"))
    try:
        yield service
    finally:
        service.command.end()


def shot(page: Page, name: str) -> None:
    if SHOTS:
        page.screenshot(path=f"{SHOTS}/{name}.png", full_page=True)


def done(page: Page, step: str) -> None:
    expect(page.locator(f'[data-step="{step}"] .mark')).to_have_text(re.compile("^✓"))


def use(page: Page, button: str, channel: str, scale: str | None = None) -> None:
    """Choose a value that makes sense, and say which channel it is."""
    page.get_by_role("button", name=button, exact=True).click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Channel", exact=True).select_option(channel)
    if scale is not None:
        dialog.get_by_label("Scale (value = raw × scale + offset)").fill(scale)
    dialog.get_by_role("button", name="Use as this channel").click()
    expect(dialog).to_have_count(0)


def load_again(page: Page) -> None:
    """The browser asks before an unsaved draft is left; what was entered is there afterwards."""
    asked: list[str] = []

    def accept(dialog: Dialog) -> None:
        asked.append(dialog.type)
        dialog.accept()

    page.once("dialog", accept)
    page.reload()
    expect(page.get_by_text("before the page was loaded again is here")).to_be_visible()
    assert asked == ["beforeunload"]


def test_a_newcomers_bench_is_live_from_the_browser(
    context: BrowserContext, service: EmptyService, bench: StrangeBench, tmp_path: Path
) -> None:
    began_s = time.monotonic()
    page = context.new_page()
    page.set_default_timeout(WAIT_MS)
    page.goto(f"{service.address}/#key={service.key}")
    page.get_by_role("link", name="Commission an asset: from its address").click()
    expect(page.get_by_role("heading", name="Commissioning", exact=True)).to_be_visible()
    shot(page, "1-empty")

    # Modbus: the unit and the registers are found, and the order of the words by looking.
    page.get_by_label("Host", exact=True).fill("127.0.0.1")
    page.get_by_label("Port", exact=True).fill(str(bench.modbus_port))
    page.get_by_role("button", name="Add source").click()
    page.get_by_role("button", name="Find units").click()
    expect(page.get_by_text(f"Answer: unit {UNIT} (asked 1 to 8).")).to_be_visible()
    expect(page.get_by_label("Unit", exact=True)).to_have_value(str(UNIT))
    page.get_by_label("First register", exact=True).fill("32")
    page.get_by_role("button", name="Show registers").click()
    expect(page.get_by_text("5 of 32 registers are there")).to_be_visible()
    shot(page, "2-registers")
    first = FIRST_REGISTER
    use(page, f"Use register {first} as float32 CDAB: {OUTER_C}", "Outer ring (°C)")
    use(page, f"Use register {first + 2} as int16: {INNER_C * 10:g}", "Inner ring (°C)", "0,1")
    use(page, f"Use register {first + 3} as float32 CDAB: {AMBIENT_C}", "Ambient (°C)")
    page.get_by_role("button", name="Stop reading").click()

    # CAN: the signals that really arrive.
    dbc = tmp_path / "spindle.dbc"
    dbc.write_text(DBC)
    page.get_by_text("Add a source", exact=True).click()
    page.get_by_label("Kind of source").select_option("CAN bus")
    page.get_by_label("Host", exact=True).fill("127.0.0.1")
    page.get_by_label("Port", exact=True).fill(str(bench.can_port))
    page.get_by_label("DBC file").set_input_files(dbc)
    page.get_by_role("button", name="Add source").click()
    page.get_by_role("button", name="Listen", exact=True).click()
    expect(page.get_by_text("3 of 4 signals arrive.")).to_be_visible()
    shot(page, "3-signals")
    use(page, "Use SpindleState.ShaftRpm", "Speed (rpm)")
    use(page, "Use ForceCell.RadialForce", "Load (N)")
    for step in ("sources", "channels"):
        done(page, step)
    expect(page.locator('[data-channel="t_inner_ring_c"]')).to_contain_text("int16 × 0.1")
    load_again(page)
    for step in ("sources", "channels"):
        done(page, step)
    expect(page.locator('[data-channel="t_inner_ring_c"]')).to_contain_text(f"{INNER_C:g} °C")

    save = page.get_by_role("button", name="Save", exact=True)
    expect(save).to_have_attribute("title", "First: the bearing, limits.")
    page.get_by_label("Asset id").fill("spindle-1")
    page.get_by_label("Bearing", exact=True).select_option("6016 (80 × 125 × 22 mm)")
    done(page, "bearing")
    corner = page.get_by_role("slider", name="Corner of the low-risk region")
    corner.press("ArrowLeft")
    expect(page.get_by_label("Low risk up to this speed in rpm")).to_have_value("4200")
    page.get_by_label("Low risk up to this load in N").fill("3000")
    # As in Germany, in a browser whose language is English.
    warning = page.get_by_label("Inner ring: warning in °C")
    warning.fill("1,070")
    expect(page.get_by_text("“1,070” can mean 1.070 or 1070: write one of these.")).to_be_visible()
    expect(page.locator('[data-step="limits"] .mark')).to_have_text(
        "○ Inner ring: both limits are needed."
    )
    warning.fill("70,5")
    expect(page.get_by_text("= 70.5 °C")).to_be_visible()
    page.get_by_label("I confirm region and limits").check()
    done(page, "limits")

    page.get_by_role("button", name="Check everything").click()
    done(page, "check")
    expect(page.get_by_text(f"✓ Inner ring: {INNER_C} °C")).to_be_visible()
    shot(page, "4-checked")
    save.click()
    expect(page.get_by_text("✓ Live: 5 of 5 channels are live.")).to_be_visible()
    assert page.evaluate("sessionStorage.getItem('commissioning')") is None
    took_s = time.monotonic() - began_s
    shot(page, "5-live")

    snapshot = httpx2.get(
        f"{service.address}/api/v1/assets/spindle-1/snapshot", headers={"X-API-Key": service.key}
    ).json()
    wanted = {
        "t_inner_ring_c": INNER_C,
        "t_outer_ring_c": OUTER_C,
        "ambient_c": AMBIENT_C,
        "speed_rpm": SPEED_RPM,
        "load_n": LOAD_N,
    }
    assert {name: snapshot["tags"][name]["value"] for name in wanted} == wanted
    saved = service.tables()["assets"][0]
    assert saved["low_risk"] == {"speed_rpm_max": 4200, "load_n_max": 3000}
    assert saved["limits"]["t_inner_ring_c"] == {"warning": 70.5, "alarm": 105}
    assert saved["bearing"] == "6016"
    page.get_by_role("link", name="Open the operator’s page").click()
    expect(page.locator("body")).to_have_attribute("data-view", "operator")
    assert took_s < WITHIN_S
    sys.stdout.write(f"live after {took_s:.0f} s\n")


def test_a_saved_asset_is_undone_and_restored(
    context: BrowserContext, service: EmptyService
) -> None:
    page = context.new_page()
    page.set_default_timeout(WAIT_MS)
    page.goto(f"{service.address}/#key={service.key}")
    page.locator("nav.tabs a[aria-current]").wait_for()
    page.goto(f"{service.address}/#commissioning")
    axe = files("axe_playwright_python").joinpath("axe.min.js").read_text("utf-8")
    page.evaluate(axe)
    expect(page.get_by_text("current", exact=True)).to_be_visible()
    found = violations_in_all_sizes(page, "commissioning")
    page.set_viewport_size(PHONE)  # type: ignore[arg-type]
    shot(page, "6-phone")
    wide = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
    assert page.evaluate(wide) <= 0
    page.set_viewport_size({"width": 1280, "height": 900})
    page.evaluate("localStorage.setItem('theme', 'light')")
    page.reload()
    expect(page.get_by_text("current", exact=True)).to_be_visible()
    page.evaluate(axe)
    shot(page, "7-light")
    found += violations_in_all_sizes(page, "commissioning, other theme")
    assert not found, "\n".join(found)
    page.get_by_role("button", name="Restore…, version 1").click()
    page.get_by_role("dialog").get_by_role("button", name="Restore").click()
    expect(page.get_by_text("Version 1 is restored.")).to_be_visible()
    assert "assets" not in service.tables()


@pytest.mark.thorough
def test_only_an_administrator_commissions(
    browser: Browser, context: BrowserContext, service: EmptyService
) -> None:
    headers = {"X-API-Key": service.key}
    body = {"role": "engineer"}
    made: list[str] = []

    def make() -> bool:
        with suppress(httpx2.HTTPError):  # the service starts again after the undo
            answer = httpx2.post(f"{service.address}/api/v1/keys", headers=headers, json=body)
            if answer.is_success:
                made.append(answer.json()["key"])
        return bool(made)

    wait_until(make, 60, "a key")
    page = context.new_page()
    page.set_default_timeout(WAIT_MS)
    page.goto(f"{service.address}/#key={made[0]}")
    expect(page.get_by_text("No asset is configured yet.")).to_be_visible()
    expect(page.get_by_role("link", name="Commission an asset")).to_have_count(0)
