"""How long tests wait for what must come: longer on a slow or busy machine, by one factor.

It is measured once, where a run begins, and holds for its workers and the programs that they start.
"""

import asyncio
import os
import statistics
import time
from collections.abc import Awaitable
from typing import Final, TypeVar

Came = TypeVar("Came")

VARIABLE: Final = "TESTS_SLOWNESS"
#: Wall seconds of the reference work with a processor of an ordinary machine for itself.
ORDINARY_S: Final = 0.16
MOST: Final = 10.0


def slowness() -> float:
    """How much slower this machine is than an ordinary one; 1 where it is as fast, or faster."""
    known = os.environ.get(VARIABLE)
    if known is None:
        measured = statistics.median(_reference_s() for _ in range(5)) / ORDINARY_S
        known = os.environ[VARIABLE] = f"{min(max(measured, 1.0), MOST):.1f}"
    return float(known)


def patience(seconds: float) -> float:
    """What a wait of so many seconds, or of any other unit, is on this machine."""
    return seconds * slowness()


def within(seconds: float) -> asyncio.Timeout:
    """As `asyncio.timeout`, with patience."""
    return asyncio.timeout(patience(seconds))


async def wait_for(awaited: Awaitable[Came], seconds: float) -> Came:
    """As `asyncio.wait_for`, with patience."""
    return await asyncio.wait_for(awaited, patience(seconds))


def _reference_s() -> float:
    began_s = time.perf_counter()
    total = 0
    for number in range(2_000_000):
        total += number * number % 7
    return time.perf_counter() - began_s
