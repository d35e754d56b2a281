"""No cell of a CSV file that the product writes is a formula."""

import csv
import io

import pytest

from service.spreadsheets import quoted_cell, text_cell, text_of
from service.store import StoredSample
from service.transfer.pages import ExportPosition, as_csv

FORMULAS = [
    '=HYPERLINK("http://evil.example";"x")',
    "=1+1",
    "=cmd|' /C calc'!A0",
    "+1+cmd",
    "-2+3",
    "@SUM(A1)",
    "\uff1d1+1",
    "-",
    "=",
]
HARMLESS = ["", "seen", "-3.5", "+2", "-1e-5", "1.5", "a=b", "it's -2", "'5", "5;-3;+2", " -3"]
#: A spreadsheet of German settings cuts a line at a semicolon; a quotation mark in the middle
#: means nothing there.
INNER = {
    "\t=1": "\t'=1",
    "\r=1": "\r'=1",
    "\n=1": "\n'=1",
    "seen;=1+1": "seen;'=1+1",
    "a;b; =1+1;@x": "a;b;' =1+1;'@x",
    "two\r\n=1\n+x": "two\r\n'=1\n'+x",
    "=a;=b": "'=a;'=b",
    'seen;"=1+1;"': 'seen;\'"=1+1;"',
    " =1": "' =1",
    "\ufeff=1": "'\ufeff=1",
    "'=1": "''=1",  # its own apostrophe comes back
    "x;'-y": "x;''-y",
    "\u200b\u00a0=1": "'\u200b\u00a0=1",
}


@pytest.mark.parametrize("text", FORMULAS)
def test_a_formula_becomes_a_text(text: str) -> None:
    assert text_cell(text) == f"'{text}"
    ((read,),) = csv.reader(io.StringIO(quoted_cell(text), newline=""))
    assert read == f"'{text}"
    place = ExportPosition(resolution="raw", start_us=0, end_us=1, channels=None)
    row = as_csv([StoredSample(text, 0, 1.0, 192, 0)], place)
    ((_, channel, *_),) = csv.reader(io.StringIO(row, newline=""))
    assert channel == f"'{text}"


@pytest.mark.parametrize("text", INNER)
def test_no_part_of_a_cell_becomes_a_formula(text: str) -> None:
    assert text_cell(text) == INNER[text]
    assert text_of(INNER[text]) == text
    # As such a spreadsheet cuts it: each line at its semicolons.
    for line in quoted_cell(text).splitlines():
        for part in line.split(";"):
            assert part.lstrip(' "\ufeff\u200b\u00a0\t')[:1] not in ("=", "+", "@"), part


@pytest.mark.parametrize("text", HARMLESS)
def test_other_texts_and_numbers_stay(text: str) -> None:
    assert text_cell(text) == text
