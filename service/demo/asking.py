"""Asks the service of a demo and waits while it is busy or starts a side again."""

import asyncio
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType

import httpx2

from service.demo.processes import DemoError

#: Wall seconds without a usable answer after which the demo ends; a busy machine takes its time.
PATIENCE_WALL_S = 600.0
_PAUSE_WALL_S = 1.0
_LONGEST_PAUSE_WALL_S = 30.0
#: After so many wall seconds the person who watches reads what the demo waits for.
_SAY_AFTER_WALL_S = 10.0


async def ask(
    client: httpx2.AsyncClient,
    path: str,
    report: Callable[[str], None],
    parameters: Mapping[str, str] = MappingProxyType({}),
    patience_wall_s: float = PATIENCE_WALL_S,
) -> httpx2.Response:
    """Get a path; a 503, a time-out and a broken connection are tried again.

    ``patience_wall_s``: wall seconds after which it ends. Raises `DemoError` if there is no other
    answer than 503 in time.
    """
    began_s = time.monotonic()
    said = False
    while True:
        pause_s, reason = _PAUSE_WALL_S, ""
        try:
            answer = await client.get(path, params=parameters)
            if answer.status_code != httpx2.codes.SERVICE_UNAVAILABLE:
                return answer
            reason = f"HTTP 503 {answer.text[:200]}"
            asked = answer.headers.get("Retry-After", "")
            pause_s = min(float(asked), _LONGEST_PAUSE_WALL_S) if asked.isdigit() else pause_s
        except httpx2.TransportError as error:
            reason = repr(error)
        waited_s = time.monotonic() - began_s
        if waited_s > patience_wall_s:
            raise DemoError(f"{path}: no answer within {patience_wall_s:g} s; last: {reason}")
        if not said and waited_s > _SAY_AFTER_WALL_S:
            said = True
            report(f"The service is busy; waiting for {path}.")
        await asyncio.sleep(pause_s)
