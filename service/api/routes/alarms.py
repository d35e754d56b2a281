"""Alarms: those that are not over, their journal, and the operator's word."""

from typing import Annotated

from fastapi import APIRouter, Path, Query
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from service.alarms import (
    ACTIVE_STATES,
    UNACKNOWLEDGED_STATES,
    AlarmState,
    UnknownAlarmError,
    alarm_document,
    transition_document,
)
from service.api.access import Caller, secured
from service.api.bodies import AlarmDocument, AlarmJournalList, AlarmList
from service.api.context import RequestBody
from service.api.cursors import decode_cursor, encode_cursor, next_link
from service.api.deps import Context, json_response
from service.api.problems import Problem, parameter_problem
from service.api.times import Instant
from service.security.roles import OPERATOR, VIEWER

JOURNAL_LIMIT = 100
JOURNAL_LIMIT_MAX = 1000
_FLUSH_S = 1.0

router = APIRouter(prefix="/alarms", tags=["alarms"])


class AcknowledgeRequest(RequestBody):
    """An operator has seen it."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"comment": "load is being reduced"}]}
    )

    comment: str | None = Field(None, max_length=500, description="For the journal.")


class JournalPlace(BaseModel):
    """Where a page of the journal ended."""

    before: int = Field(ge=0, lt=2**63)


@router.get("", response_model=AlarmList, summary="Alarms that are not over", **secured(VIEWER))
async def list_alarms(
    context: Context,
    asset: Annotated[str | None, Query(description="Only of this asset.")] = None,
    active: Annotated[
        bool | None, Query(description="Only those whose condition is there (or is not).")
    ] = None,
    unacknowledged: Annotated[
        bool | None, Query(description="Only those that wait for an operator (or do not).")
    ] = None,
) -> Response:
    """Most urgent first, then newest."""
    items = [
        alarm_document(alarm)
        for alarm in context.alarms.active(asset)
        if active in (None, AlarmState(alarm.state) in ACTIVE_STATES)
        and unacknowledged in (None, AlarmState(alarm.state) in UNACKNOWLEDGED_STATES)
    ]
    return json_response({"items": items, "next": None})


@router.get(
    "/journal",
    response_model=AlarmJournalList,
    summary="Everything that happened to alarms",
    **secured(VIEWER, 503),
)
def get_journal(
    context: Context,
    request: Request,
    start: Annotated[Instant | None, Query(description="From this process time on.")] = None,
    end: Annotated[Instant | None, Query(description="Before this process time.")] = None,
    limit: Annotated[int, Query(ge=1, le=JOURNAL_LIMIT_MAX)] = JOURNAL_LIMIT,
    cursor: Annotated[str | None, Query(description="`next` of the page before.")] = None,
) -> Response:
    """Newest first: raised, returned, acknowledged, with who and why."""
    if start is not None and end is not None and end <= start:
        raise parameter_problem("end", "expected a time later than start")
    before = None if cursor is None else decode_cursor(cursor, JournalPlace).before
    context.alarms.flush(_FLUSH_S)  # what an operator has just done is in the answer
    page = context.store.alarm_journal(start, end, limit, before)
    following = None
    if page.next_cursor is not None:
        following = encode_cursor(JournalPlace(before=page.next_cursor))
    items = [transition_document(line) for line in page.items]
    return json_response({"items": items, "next": following}, headers=next_link(request, following))


@router.post(
    "/{alarm_id}/acknowledge",
    response_model=AlarmDocument,
    summary="Acknowledge an alarm",
    **secured(OPERATOR, 400, 404, 409, 413),
)
async def acknowledge_alarm(
    context: Context,
    who: Caller,
    alarm_id: Annotated[str, Path(max_length=64)],
    request: AcknowledgeRequest | None = None,
) -> Response:
    """Take note of an alarm; one that has returned to normal is over thereby."""
    try:
        alarm = context.alarms.alarm(alarm_id)
        if AlarmState(alarm.state) not in UNACKNOWLEDGED_STATES:
            by = f" by {alarm.acknowledged_by}" if alarm.acknowledged_by else ""
            raise Problem(409, f"alarm {alarm_id} is {alarm.state}: acknowledged already{by}")
        comment = (request.comment if request else None) or ""
        alarm = context.alarms.acknowledge(alarm_id, who.who, comment)
    except UnknownAlarmError as error:
        raise parameter_problem("alarm_id", f"no open alarm {alarm_id!r}", 404) from error
    return json_response(alarm_document(alarm))
