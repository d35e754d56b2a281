"""Texts in CSV files, which spreadsheets open: none of them is ever a formula."""

import re
from functools import lru_cache

from adapters.tables import NUMBER

#: What a spreadsheet evaluates, or takes away before it looks.
_FORMULA = re.compile("[=+@\\-\t\r\n\uff1d\uff0b\uff0d\uff20]")
_NEEDS_QUOTES = re.compile('[",\r\n]')


def text_cell(text: str) -> str:
    """Give a text that a spreadsheet takes for a text: an apostrophe before what it would evaluate.

    Numbers stay as they are.
    """
    if _FORMULA.match(text) and not NUMBER.fullmatch(text):
        return f"'{text}"
    return text


def text_of(cell: str) -> str:
    """Give the text of which `text_cell` made a cell."""
    return cell[1:] if cell.startswith("'") and text_cell(cell[1:]) == cell else cell


def cell(value: object) -> object:
    """Give a cell for `csv.writer`: texts as `text_cell`, anything else as it is."""
    return text_cell(value) if isinstance(value, str) else value


@lru_cache(maxsize=1024)
def quoted_cell(text: str) -> str:
    """Give a text for a line of CSV that is put together by hand."""
    text = text_cell(text)
    if not _NEEDS_QUOTES.search(text):
        return text
    return '"' + text.replace('"', '""') + '"'
