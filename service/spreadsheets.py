"""Texts in CSV files, which spreadsheets open: none of them is ever a formula."""

import re
from functools import lru_cache

from adapters.tables import NUMBER

#: What a spreadsheet evaluates, perhaps behind what it removes or does not show.
_FORMULA = re.compile('[ "\u00a0\u200b\ufeff]*[=+@\\-\uff1d\uff0b\uff0d\uff20]')
#: Where a spreadsheet of another language cuts a line: a quotation mark within it means nothing.
_CUTS = re.compile("([;\t\r\n])")
_NEEDS_QUOTES = re.compile('[",\r\n]')


def text_cell(text: str) -> str:
    """Give a text that a spreadsheet takes for a text: an apostrophe before what it would evaluate.

    Also after each semicolon, tab and end of line. Numbers stay as they are.
    """
    return "".join(map(_part, _CUTS.split(text)))


def _part(text: str) -> str:
    # An apostrophe of the text itself before a formula is kept by another one.
    begin = text.lstrip("'")
    is_formula = _FORMULA.match(begin) and not NUMBER.fullmatch(begin.strip(" "))
    return f"'{text}" if is_formula else text


def text_of(cell: str) -> str:
    """Give the text of which `text_cell` made a cell."""
    return "".join(
        part[1:] if part.startswith("'") and _part(part[1:]) == part else part
        for part in _CUTS.split(cell)
    )


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
