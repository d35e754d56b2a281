"""Alarms: those that are not over, and what operators and engineers say to them."""

from bisect import bisect_right
from typing import Annotated

from fastapi import APIRouter, Path, Query
from pydantic import BaseModel
from starlette.requests import Request
from starlette.responses import Response

from service.alarms import (
    ACTIVE_STATES,
    UNACKNOWLEDGED_STATES,
    AlarmState,
    NotAllowedError,
    UnknownAlarmError,
)
from service.alarms.records import urgency
from service.bus.commands import AlarmAction, Alarms
from service.documents.alarms import (
    AcknowledgedAlarms,
    AlarmDocument,
    AlarmList,
    FailedAlarm,
    alarm_document,
)
from service.domain.roles import ENGINEER, OPERATOR, VIEWER
from service.store import AuditEntry
from service.web.api.access import secured
from service.web.api.alarm_bodies import (
    AcknowledgeManyRequest,
    CommentedRequest,
    CommentRequest,
    ShelveRequest,
)
from service.web.api.context import ServiceContext
from service.web.api.cursors import Cursor, LimitOrAll, decode_cursor, encode_cursor, next_link
from service.web.api.deps import AssetFilter, Context, json_response
from service.web.api.problems import Problem, parameter_problem
from service.web.api.trail import ChangeLine

_CONFLICTS = (400, 404, 409, 413)

router = APIRouter(prefix="/alarms", tags=["alarms"])


class _Place(BaseModel):
    """Where a page ended."""

    key: tuple[int, int, int, int, int, str]


AlarmId = Annotated[str, Path(max_length=64, description="`id` of the alarm.")]


@router.get("", response_model=AlarmList, summary="List open alarms", **secured(VIEWER))
async def list_alarms(
    request: Request,
    context: Context,
    asset: AssetFilter,
    state: Annotated[
        list[AlarmState] | None,
        Query(
            description="Only in these states, repeatable; absent: all but NORM. With NORM also "
            "the normal conditions, which can be shelved or taken out of service too."
        ),
    ] = None,
    active: Annotated[
        bool | None,
        Query(description="Only active alarms (or only inactive ones)."),
    ] = None,
    unacknowledged: Annotated[
        bool | None, Query(description="Only unacknowledged alarms (or only the others).")
    ] = None,
    limit: LimitOrAll = None,
    cursor: Cursor = None,
) -> Response:
    """Give the order of the page: unacknowledged first; then by priority, measured first, newest.

    What is acknowledged follows, then what has returned; what is set aside comes last. In pages an
    alarm that changes meanwhile may be in two of them, or in none.
    """
    place = None if cursor is None else decode_cursor(cursor, _Place)
    if limit is None and place is not None:
        raise parameter_problem("cursor", "expected a limit with it")
    alarms = await context.cell.open_alarms(asset)
    if state and AlarmState.NORM in state:
        alarms += await context.cell.normal_alarms(asset)
    found = [
        alarm
        for alarm in alarms
        if (not state or AlarmState(alarm.state) in state)
        and active in (None, AlarmState(alarm.state) in ACTIVE_STATES)
        and unacknowledged in (None, AlarmState(alarm.state) in UNACKNOWLEDGED_STATES)
    ]
    begin = 0 if place is None else bisect_right(found, place.key, key=urgency)
    page = found[begin : None if limit is None else begin + limit]
    more = begin + len(page) < len(found)
    following = encode_cursor(_Place(key=urgency(page[-1]))) if more else None
    answer = AlarmList(items=[alarm_document(alarm) for alarm in page], next=following)
    return json_response(answer, headers=next_link(request, following))


@router.post(
    "/acknowledge",
    response_model=AcknowledgedAlarms,
    summary="Acknowledge several alarms",
    **secured(OPERATOR, 400, 413),
)
async def acknowledge_alarms(
    context: Context, line: ChangeLine, request: AcknowledgeManyRequest
) -> Response:
    """Acknowledge several alarms; `failed` names those that could not be, and why."""
    done = await context.cell(Alarms).acknowledge(
        request.ids, line.who, request.comment or "", line
    )
    return json_response(
        AcknowledgedAlarms(
            items=[alarm_document(alarm) for alarm in done.alarms],
            failed=[FailedAlarm(id=alarm_id, detail=detail) for alarm_id, detail in done.failed],
        )
    )


@router.post(
    "/{alarm_id}/acknowledge",
    response_model=AlarmDocument,
    summary="Acknowledge an alarm",
    **secured(OPERATOR, *_CONFLICTS),
)
async def acknowledge_alarm(
    context: Context, line: ChangeLine, alarm_id: AlarmId, request: CommentedRequest | None = None
) -> Response:
    """Acknowledge an alarm. An alarm that has returned to normal is cleared unless latched."""
    return await _done(context, alarm_id, "acknowledge", line, _comment(request))


@router.post(
    "/{alarm_id}/shelve",
    response_model=AlarmDocument,
    summary="Shelve an alarm for a time",
    **secured(OPERATOR, *_CONFLICTS),
)
async def shelve_alarm(
    context: Context, line: ChangeLine, alarm_id: AlarmId, request: ShelveRequest
) -> Response:
    """Shelve an alarm; when the time is over it is back automatically, as its condition is then."""
    return await _done(context, alarm_id, "shelve", line, request.comment or "", request.duration_s)


@router.post(
    "/{alarm_id}/unshelve",
    response_model=AlarmDocument,
    summary="End the shelving of an alarm",
    **secured(OPERATOR, *_CONFLICTS),
)
async def unshelve_alarm(
    context: Context, line: ChangeLine, alarm_id: AlarmId, request: CommentedRequest | None = None
) -> Response:
    """Bring a shelved alarm back before its time is over."""
    return await _done(context, alarm_id, "unshelve", line, _comment(request))


@router.post(
    "/{alarm_id}/reset",
    response_model=AlarmDocument,
    summary="Reset a latched alarm",
    **secured(OPERATOR, *_CONFLICTS),
)
async def reset_alarm(
    context: Context, line: ChangeLine, alarm_id: AlarmId, request: CommentedRequest | None = None
) -> Response:
    """End a latched alarm (state LATCH) whose condition is gone and that is acknowledged."""
    return await _done(context, alarm_id, "reset", line, _comment(request))


@router.post(
    "/{alarm_id}/comment",
    response_model=AlarmDocument,
    summary="Comment on an alarm",
    **secured(OPERATOR, *_CONFLICTS),
)
async def comment_alarm(
    context: Context, line: ChangeLine, alarm_id: AlarmId, request: CommentRequest
) -> Response:
    """Add a comment to the journal; the alarm shows the latest one."""
    return await _done(context, alarm_id, "comment", line, request.comment)


@router.post(
    "/{alarm_id}/out-of-service",
    response_model=AlarmDocument,
    summary="Take an alarm out of service",
    **secured(ENGINEER, *_CONFLICTS),
)
async def take_alarm_out_of_service(
    context: Context, line: ChangeLine, alarm_id: AlarmId, request: CommentRequest
) -> Response:
    """Take an alarm out of service until it is returned; the comment says why."""
    return await _done(context, alarm_id, "take_out_of_service", line, request.comment)


@router.post(
    "/{alarm_id}/return-to-service",
    response_model=AlarmDocument,
    summary="Return an alarm to service",
    **secured(ENGINEER, *_CONFLICTS),
)
async def return_alarm_to_service(
    context: Context, line: ChangeLine, alarm_id: AlarmId, request: CommentedRequest | None = None
) -> Response:
    """Return an alarm to service; it is unacknowledged or normal, as its condition is then."""
    return await _done(context, alarm_id, "return_to_service", line, _comment(request))


async def _done(
    context: ServiceContext,
    alarm_id: str,
    action: AlarmAction,
    line: AuditEntry,
    comment: str,
    duration_s: float = 0.0,
) -> Response:
    """Do something to an alarm; the answer comes when the journal is on the disk."""
    try:
        alarm = await context.cell(Alarms).act(
            alarm_id, action, line.who, comment, duration_s, line
        )
    except UnknownAlarmError as error:
        raise parameter_problem("alarm_id", f"no open alarm {alarm_id!r}", 404) from error
    except NotAllowedError as error:
        raise Problem(409, str(error)) from error
    return json_response(alarm_document(alarm))


def _comment(request: CommentedRequest | None) -> str:
    return (request.comment if request else None) or ""
