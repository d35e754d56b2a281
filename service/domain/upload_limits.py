"""Bounds of what callers send in tables: columns, cells, and the processor time of a judgement."""

import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, TypeVar

from service.domain.errors import BearingTwinError

#: Columns of a sheet, and keys of a table or entries of a list in JSON.
COLUMNS_MAX: Final = 200
#: Cells of a sheet.
CELLS_MAX: Final = 1_000_000
#: Values of one table in JSON, with all tables in it.
VALUES_MAX: Final = 5_000
#: Processor seconds of each step in which the rows of an upload are judged.
JUDGING_S: Final = 30.0
#: Signals of a DBC file.
SIGNALS_MAX: Final = 20_000

Item = TypeVar("Item")


class UploadTooLargeError(BearingTwinError, ValueError):
    """An upload that asks for too much work; the text is one line for the user."""


def too_large(table: object) -> str | None:
    """Say why a table in JSON is too large: one line; None where it is not."""
    waiting: list[object] = [table]
    values = 0
    while waiting:
        part = waiting.pop()
        if not isinstance(part, Mapping | list):
            continue
        if len(part) > COLUMNS_MAX:
            what = "keys" if isinstance(part, Mapping) else "entries"
            return f"{len(part)} {what}; expected at most {COLUMNS_MAX}"
        values += len(part)
        if values > VALUES_MAX:
            return f"more than {VALUES_MAX} values; expected at most {VALUES_MAX}"
        waiting += part.values() if isinstance(part, Mapping) else part
    return None


def small_enough(table: object) -> object:
    """Give a table back when it is small enough. Raises `ValueError`: why it is not."""
    problem = too_large(table)
    if problem is not None:
        raise ValueError(problem)
    return table


def in_time(items: Iterable[Item], seconds: float | None) -> Iterator[Item]:
    """Give items for so many processor seconds of this thread; None: without an end.

    Raises `UploadTooLargeError` when they are over.
    """
    end_s = None if seconds is None else time.thread_time() + seconds
    for item in items:
        if end_s is not None and time.thread_time() > end_s:
            raise UploadTooLargeError(
                f"takes more than {seconds:g} s of processor time; expected less: send it in parts"
            )
        yield item
