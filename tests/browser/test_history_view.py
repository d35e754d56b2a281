"""The past: from hours to raw samples, with its holes, and out of the page as a file."""

import re
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from service.clock import rfc3339
from tests.browser.plant import BEARING, Plant

pytestmark = pytest.mark.browser

Screen = Callable[..., Page]
US = 1_000_000
LENGTH_S = 6 * 3600
BAD_S = (7200, 9000)


@pytest.fixture(scope="module")
def past(started_plant: Plant) -> int:
    """Six hours of ambient temperature, one sample a second, long ago; gives their start in µs."""
    start_us = started_plant.clock.now_us() // US * US - 40 * 86_400 * US
    for first in range(0, LENGTH_S, 5000):
        samples: list[dict[str, Any]] = [
            {
                "channel": "ambient_c",
                "time": rfc3339(start_us + second * US),
                "value": 20 + second / LENGTH_S,
                "quality": 16 if BAD_S[0] <= second < BAD_S[1] else 192,
            }
            for second in range(first, min(first + 5000, LENGTH_S))
        ]
        started_plant.push_all(BEARING, samples)
    return start_us


def violet(page: Page) -> int:
    """Violet pixels of the temperature chart: the hatching of data that are not to be trusted."""
    count: int = page.locator(".p-past .t canvas").evaluate(
        """(canvas) => {
          const copy = new OffscreenCanvas(canvas.width, canvas.height)
            .getContext('2d', { willReadFrequently: true });
          copy.drawImage(canvas, 0, 0);
          const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
          let count = 0;
          for (let i = 0; i < data.length; i += 4) {
            if (data[i] > data[i + 1] + 15 && data[i + 2] > data[i + 1] + 15) count += 1;
          }
          return count;
        }"""
    )
    return count


def choose(page: Page, start_us: int, end_us: int) -> None:
    """Ask for a span in the inputs, which count in the browser's own time."""
    for name, time_us in (("From", start_us), ("To", end_us)):
        local = page.evaluate(
            """(ms) => new Date(ms - new Date(ms).getTimezoneOffset() * 60000)
              .toISOString().slice(0, 19)""",
            time_us / 1000,
        )
        page.get_by_label(name, exact=True).fill(local)
        page.get_by_label(name, exact=True).dispatch_event("change")


def test_zoom_to_raw_and_back(screen: Screen, past: int, problems: list[str]) -> None:
    page = screen(f"history/{BEARING}")
    status = page.locator(".p-past [role=status]")
    page.get_by_role("checkbox", name="Ambient").check()
    for name in ("Inner ring", "Outer ring", "Speed", "Load"):
        page.get_by_role("checkbox", name=re.compile(f"^{name} ?[°rN]")).uncheck()
    choose(page, past, past + LENGTH_S * US)
    expect(status).to_contain_text("mean, minimum and maximum per 15 s")
    assert violet(page) > 500, "half an hour of bad samples is hatched"
    row = page.locator(".p-hval tr", has_text="Ambient")
    expect(row.locator("td").nth(1)).to_have_text("20.0")
    expect(row.locator("td").nth(3)).to_have_text("21.0")

    plot = page.locator(".p-past .t .u-over")
    box = plot.bounding_box()
    assert box is not None
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + box["width"] * 0.70, middle)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.73, middle, steps=4)
    page.mouse.up()
    expect(status).to_contain_text("raw samples")
    count = int(status.inner_text().split()[0])
    assert count == pytest.approx(0.03 * LENGTH_S, rel=0.1)
    assert violet(page) == 0
    page.get_by_role("button", name="Back to the previous range").click()
    expect(status).to_contain_text("per 15 s")
    assert problems == []


@pytest.mark.thorough
@pytest.mark.parametrize("format", ["CSV", "Parquet"])
def test_what_is_seen_is_saved(screen: Screen, past: int, problems: list[str], format: str) -> None:
    parquet = pytest.importorskip("pyarrow.parquet") if format == "Parquet" else None
    page = screen(f"history/{BEARING}")
    page.get_by_role("checkbox", name="Ambient").check()
    choose(page, past + 60 * US, past + 660 * US)
    expect(page.locator(".p-past [role=status]")).to_have_text("600 values: raw samples")
    with page.expect_download() as saved:
        page.get_by_role("button", name=f"Save the shown data as {format}").click()
    path = saved.value.path()
    if parquet is None:
        rows = path.read_text(encoding="utf-8").split()
        assert len(rows) == 601
        assert rows[1].startswith(f"{rfc3339(past + 60 * US)},ambient_c,")
    else:
        assert parquet.read_table(path).num_rows == 600
    assert problems == []


@pytest.mark.thorough
def test_the_zone_is_that_of_the_range(screen: Screen, problems: list[str]) -> None:
    """Of a day in July, and of a range over the night in which the clocks are changed."""
    page = screen(f"history/{BEARING}")
    controls = page.locator(".p-hctl")
    for start, end, zone in (
        ("2026-07-01T10:00:00", "2026-07-01T18:00:00", "CEST"),
        ("2026-01-10T10:00:00", "2026-01-10T18:00:00", "CET"),
        ("2026-03-28T12:00:00", "2026-03-29T12:00:00", "CET to CEST"),
    ):
        page.get_by_label("From", exact=True).fill(start)
        page.get_by_label("To", exact=True).fill(end)
        page.get_by_label("To", exact=True).dispatch_event("change")
        expect(controls.get_by_text(zone, exact=True)).to_be_visible()
    assert problems == []


@pytest.mark.thorough
def test_the_limits_of_a_line_are_picked_in_the_table(
    screen: Screen, past: int, problems: list[str]
) -> None:
    page = screen(f"history/{BEARING}")
    row = page.locator(".p-hval tr", has_text="Inner ring").first
    pick = row.get_by_role("button", name="70 / 95")
    expect(pick).to_have_attribute("aria-pressed", "false")
    pick.click()
    expect(pick).to_have_attribute("aria-pressed", "true")
    expect(page.locator(".p-hval tr", has_text="Ambient").get_by_role("button")).to_be_hidden()
    row.get_by_role("checkbox").uncheck()
    expect(pick).to_be_disabled()
    page.get_by_role("checkbox", name="Inner ring, twin").check()
    expect(pick).to_be_enabled()  # the limits of the ring hold for the twin's estimate of it
    assert problems == []
