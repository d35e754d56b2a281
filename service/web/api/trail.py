"""The line of the audit trail that a call which changes something takes with it."""

import json
from collections.abc import AsyncIterator
from typing import Annotated, Any

import structlog
from fastapi import Depends
from starlette.requests import Request

from service.clock import wall_us
from service.store import AuditEntry
from service.web.api.access import AUDIT, actor

_KEPT_BYTES = 4096
_SHOWN_CHARACTERS = 500

_log = structlog.get_logger(__name__)


async def change_line(request: Request) -> AsyncIterator[AuditEntry]:
    """Make the line of a call; it is written in the same transaction as the change.

    What it is called the route says by `service.web.api.access.secured`.
    """
    route = request.scope["route"]
    action = (route.openapi_extra or {}).get(AUDIT) or _named_after(route.path)
    line = await line_of(request, action)
    yield line
    log_line(line)


async def line_of(request: Request, action: str) -> AuditEntry:
    """Make the line of a call that changes something only now and then."""
    caller = actor(request)
    target = ", ".join(
        f"{name.removesuffix('_id')} {value}" for name, value in request.path_params.items()
    )
    return AuditEntry(
        time_us=wall_us(),
        who=caller.who,
        address=caller.address,
        action=action,
        target=target,
        detail=_shown((await request.body())[:_KEPT_BYTES]),
    )


def log_line(line: AuditEntry) -> None:
    """Log that a change was made."""
    _log.info("audit", who=line.who, address=line.address, action=line.action, target=line.target)


ChangeLine = Annotated[AuditEntry, Depends(change_line)]


def _named_after(path: str) -> str:
    """``/alarms/{alarm_id}/shelve`` is called ``alarm.shelve``."""
    *_, noun, verb = (part for part in path.split("/") if part and not part.startswith("{"))
    return f"{noun.removesuffix('s')}.{verb}"


def _shown(body: bytes) -> str:
    """What was asked for, as people read it."""
    try:
        asked: Any = json.loads(body) if body else {}
    except (ValueError, RecursionError):  # longer than what is kept, or too deep
        asked = body.decode(errors="replace")
    if isinstance(asked, dict):
        asked = "; ".join(
            f"{name}: {value if isinstance(value, str) else json.dumps(value)}"
            for name, value in asked.items()
            if value is not None
        )
    text = "".join(char if char.isprintable() else " " for char in str(asked))
    return text if len(text) <= _SHOWN_CHARACTERS else text[: _SHOWN_CHARACTERS - 1] + "…"
