"""Numbers are typed with a decimal point or a decimal comma; nothing that was typed vanishes."""

import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from service.web.pages import static_directory
from tests.browser.test_dashboard_parts import run

pytestmark = pytest.mark.browser

FIELD = """const { NumberField } = await import('/js/parts/number_field.js');
const { place } = await import('/js/parts/panel.js');
document.body.replaceChildren();
window.number = 70;
const part = place(document.body, NumberField, { id: 'limit', least: -50, most: 500, unit: '°C',
  value: 70, oninput: (number) => { window.number = number; }, ...more });
const field = document.querySelector('#limit');
Object.assign(window, { field, reading: field.nextSibling,
  setNumber: (value) => { part.update({ value }); } });"""


def typed(page: Page, text: str) -> list[Any]:
    """Type with the keyboard, sign by sign, as a user does."""
    field = page.locator("#limit")
    field.press("Control+a")
    field.press_sequentially(text) if text else field.press("Delete")
    found: list[Any] = page.evaluate(
        """() => [field.value, number, reading.textContent, field.checkValidity(),
          field.getAttribute('aria-invalid')]"""
    )
    return found


def test_the_number_is_repeated_with_its_unit(parts: Page) -> None:
    run(parts, FIELD, more={"unitShown": True})
    assert parts.evaluate("reading.textContent") == "°C"
    assert typed(parts, "70,5") == ["70,5", 70.5, "= 70.5 °C", True, "false"]
    assert typed(parts, "1.234") == ["1.234", 1.234, "= 1.234 °C", True, "false"]
    value, number, reading, valid, invalid = typed(parts, "1,234")
    assert (value, valid, invalid) == ("1,234", False, "true")
    assert number != number  # NaN: never taken as something else
    assert reading == "“1,234” can mean 1.234 or 1234: write one of these."
    assert typed(parts, "705,5")[2:4] == ["expected -50 to 500 °C.", False]
    assert typed(parts, "")[1:4] == [None, "°C", True]
    parts.evaluate("setNumber(80)")
    assert parts.evaluate("[field.value, reading.textContent]") == ["80", "°C"]


def test_arrow_keys_add_a_step_within_the_bounds(parts: Page) -> None:
    run(parts, FIELD, more={"step": 0.1, "most": 70.2})
    field = parts.locator("#limit")
    for wanted in ("70.1", "70.2", "70.2"):
        field.press("ArrowUp")
        expect(field).to_have_value(wanted)
    field.press("ArrowDown")
    expect(field).to_have_value("70.1")
    assert parts.evaluate("field.getAttribute('aria-valuenow')") == "70.1"


def test_whole_numbers_and_required_ones(parts: Page) -> None:
    run(parts, FIELD, more={"whole": True, "required": True})
    assert typed(parts, "7,5")[2:4] == ["expected a whole number.", False]
    assert typed(parts, "7")[1:4] == [7, "= 7 °C", True]
    assert not typed(parts, "")[3]


def test_every_number_of_the_page_is_typed_in_such_a_field() -> None:
    """A browser's own field for numbers drops the marks of other languages: 70,5 becomes 705."""
    own = re.compile(r"""type: ?['"]number['"]|type=["']?number""")
    found = [
        f"{path.name}: {line.strip()}"
        for path in sorted(Path(static_directory()).rglob("*"))
        if path.suffix in (".js", ".css", ".html") and "vendor" not in path.parts
        for line in path.read_text(encoding="utf-8").splitlines()
        if own.search(line)
    ]
    assert found == []
