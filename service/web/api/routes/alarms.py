"""Alarms: those that are not over, and what operators and engineers say to them."""

from collections.abc import Callable
from typing import Annotated

import anyio.to_thread
from fastapi import APIRouter, Path, Query
from starlette.responses import Response

from service.alarms import (
    ACTIVE_STATES,
    UNACKNOWLEDGED_STATES,
    AlarmBook,
    AlarmState,
    NotAllowedError,
    UnknownAlarmError,
)
from service.documents.alarms import (
    AcknowledgedAlarms,
    AlarmDocument,
    AlarmList,
    FailedAlarm,
    alarm_document,
)
from service.domain.roles import ENGINEER, OPERATOR, VIEWER
from service.store import Alarm
from service.web.api.access import Caller, secured
from service.web.api.alarm_bodies import (
    AcknowledgeManyRequest,
    CommentedRequest,
    CommentRequest,
    ShelveRequest,
)
from service.web.api.context import ServiceContext
from service.web.api.deps import Context, json_response
from service.web.api.problems import Problem, parameter_problem

_FLUSH_S = 1.0
_CONFLICTS = (400, 404, 409, 413)

router = APIRouter(prefix="/alarms", tags=["alarms"])

AlarmId = Annotated[str, Path(max_length=64, description="`id` of the alarm.")]


@router.get("", response_model=AlarmList, summary="Open alarms", **secured(VIEWER))
async def list_alarms(
    context: Context,
    asset: Annotated[str | None, Query(description="Only of this asset.")] = None,
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
) -> Response:
    """By priority; then unacknowledged, measured, newest first; what is set aside comes last."""
    alarms = context.alarms.active(asset)
    if state and AlarmState.NORM in state:
        alarms += context.alarms.normal(asset)
    items = [
        alarm_document(alarm)
        for alarm in alarms
        if (not state or AlarmState(alarm.state) in state)
        and active in (None, AlarmState(alarm.state) in ACTIVE_STATES)
        and unacknowledged in (None, AlarmState(alarm.state) in UNACKNOWLEDGED_STATES)
    ]
    return json_response(AlarmList(items=items))


@router.post(
    "/acknowledge",
    response_model=AcknowledgedAlarms,
    summary="Acknowledge several alarms",
    **secured(OPERATOR, 400, 413),
)
async def acknowledge_alarms(
    context: Context, who: Caller, request: AcknowledgeManyRequest
) -> Response:
    """Take note of several alarms; `failed` names those that could not be, and why."""
    items: list[AlarmDocument] = []
    failed: list[FailedAlarm] = []
    # An alarm of a source acknowledges those of its channels: each of them is taken first.
    sources = {one.id for one in context.alarms.active() if one.channel.startswith("source:")}
    for alarm_id in sorted(dict.fromkeys(request.ids), key=sources.__contains__):
        try:
            alarm = context.alarms.acknowledge(alarm_id, who.who, request.comment or "")
        except (UnknownAlarmError, NotAllowedError) as error:
            failed.append(FailedAlarm(id=alarm_id, detail=str(error.args[0])))
        else:
            items.append(alarm_document(alarm))
    await _written(context)
    return json_response(AcknowledgedAlarms(items=items, failed=failed))


@router.post(
    "/{alarm_id}/acknowledge",
    response_model=AlarmDocument,
    summary="Acknowledge an alarm",
    **secured(OPERATOR, *_CONFLICTS),
)
async def acknowledge_alarm(
    context: Context, who: Caller, alarm_id: AlarmId, request: CommentedRequest | None = None
) -> Response:
    """Take note of an alarm; one that has returned to normal is over thereby, unless latched."""
    return await _done(
        context, lambda book: book.acknowledge(alarm_id, who.who, _comment(request)), alarm_id
    )


@router.post(
    "/{alarm_id}/shelve",
    response_model=AlarmDocument,
    summary="Shelve an alarm for a time",
    **secured(OPERATOR, *_CONFLICTS),
)
async def shelve_alarm(
    context: Context, who: Caller, alarm_id: AlarmId, request: ShelveRequest
) -> Response:
    """Set an alarm aside; when the time is over it is back by itself, as its condition is then."""
    return await _done(
        context,
        lambda book: book.shelve(alarm_id, request.duration_s, who.who, request.comment or ""),
        alarm_id,
    )


@router.post(
    "/{alarm_id}/unshelve",
    response_model=AlarmDocument,
    summary="End the shelving of an alarm",
    **secured(OPERATOR, *_CONFLICTS),
)
async def unshelve_alarm(
    context: Context, who: Caller, alarm_id: AlarmId, request: CommentedRequest | None = None
) -> Response:
    """Bring a shelved alarm back before its time is over."""
    return await _done(
        context, lambda book: book.unshelve(alarm_id, who.who, _comment(request)), alarm_id
    )


@router.post(
    "/{alarm_id}/reset",
    response_model=AlarmDocument,
    summary="Reset a latched alarm",
    **secured(OPERATOR, *_CONFLICTS),
)
async def reset_alarm(
    context: Context, who: Caller, alarm_id: AlarmId, request: CommentedRequest | None = None
) -> Response:
    """End a latched alarm (state LATCH) whose condition is gone and that is acknowledged."""
    return await _done(
        context, lambda book: book.reset(alarm_id, who.who, _comment(request)), alarm_id
    )


@router.post(
    "/{alarm_id}/comment",
    response_model=AlarmDocument,
    summary="Comment on an alarm",
    **secured(OPERATOR, *_CONFLICTS),
)
async def comment_alarm(
    context: Context, who: Caller, alarm_id: AlarmId, request: CommentRequest
) -> Response:
    """Write a comment into the journal; the alarm shows the latest one."""
    return await _done(
        context, lambda book: book.comment(alarm_id, who.who, request.comment), alarm_id
    )


@router.post(
    "/{alarm_id}/out-of-service",
    response_model=AlarmDocument,
    summary="Take an alarm out of service",
    **secured(ENGINEER, *_CONFLICTS),
)
async def take_alarm_out_of_service(
    context: Context, who: Caller, alarm_id: AlarmId, request: CommentRequest
) -> Response:
    """Silence an alarm until someone returns it to service; the comment says why."""
    return await _done(
        context, lambda book: book.take_out_of_service(alarm_id, who.who, request.comment), alarm_id
    )


@router.post(
    "/{alarm_id}/return-to-service",
    response_model=AlarmDocument,
    summary="Return an alarm to service",
    **secured(ENGINEER, *_CONFLICTS),
)
async def return_alarm_to_service(
    context: Context, who: Caller, alarm_id: AlarmId, request: CommentedRequest | None = None
) -> Response:
    """Let an alarm work again; it is unacknowledged or normal, as its condition is then."""
    return await _done(
        context, lambda book: book.return_to_service(alarm_id, who.who, _comment(request)), alarm_id
    )


async def _done(
    context: ServiceContext, action: Callable[[AlarmBook], Alarm], alarm_id: str
) -> Response:
    """Act on the book; the answer comes when the journal is on the disk, if the store answers."""
    try:
        alarm = action(context.alarms)
    except UnknownAlarmError as error:
        raise parameter_problem("alarm_id", f"no open alarm {alarm_id!r}", 404) from error
    except NotAllowedError as error:
        raise Problem(409, str(error)) from error
    await _written(context)
    return json_response(alarm_document(alarm))


async def _written(context: ServiceContext) -> None:
    """Wait until the change is kept.

    Raises
    ------
    Problem
        With status 503 when neither the store nor the disk takes it.
    """
    outbox = context.outbox
    if await anyio.to_thread.run_sync(outbox.flush, _FLUSH_S) or not outbox.unkept:
        return
    raise Problem(
        503,
        "the change is made, but neither the store nor the disk takes it "
        f"({outbox.disk_problem or 'the disk is slow'}): it is lost if the service stops before "
        "one of them does",
    )


def _comment(request: CommentedRequest | None) -> str:
    return (request.comment if request else None) or ""
