"""The audit trail: who changed what, when and from where."""

from anyio import to_thread
from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from service.documents.access import AuditLine, AuditList
from service.domain.roles import ADMIN
from service.web.api.access import secured
from service.web.api.cursors import (
    LIMIT,
    Before,
    Cursor,
    Limit,
    decode_cursor,
    encode_cursor,
    next_link,
)
from service.web.api.deps import Context, Trail, json_response

_FLUSH_S = 1.0

router = APIRouter(prefix="/audit", tags=["access"])


@router.get("", response_model=AuditList, summary="List the audit trail", **secured(ADMIN))
async def get_audit(
    context: Context,
    request: Request,
    trail: Trail,
    limit: Limit = LIMIT,
    cursor: Cursor = None,
) -> Response:
    """Every change that someone asked for, newest first; the trail only grows."""
    before = None if cursor is None else decode_cursor(cursor, Before).before
    await trail.flush()
    await context.cell.flush_alarms(_FLUSH_S)  # and what the cell does on its own
    page = await to_thread.run_sync(context.store.audit.page, limit, before)
    following = None
    if page.next_cursor is not None:
        following = encode_cursor(Before(before=page.next_cursor))
    items = [AuditLine.of(entry) for entry in page.items]
    answer = AuditList(items=items, next=following)
    return json_response(answer, headers=next_link(request, following))
