"""Notifications of alarms: their state, and a test."""

from typing import Annotated, Final

from fastapi import APIRouter, Path
from starlette.requests import Request
from starlette.responses import Response

from service.documents.base import time_or_none
from service.domain.daily_hours import is_within
from service.domain.roles import ENGINEER, VIEWER
from service.features.notifications.documents import (
    NotificationDocument,
    NotificationList,
    NotificationMessage,
    NotificationTest,
)
from service.features.notifications.interface import Notifications, NotificationState
from service.features.notifications.sections import NotificationSection, sections_of
from service.web.api.access import secured
from service.web.api.cursors import LIMIT, Cursor, Limit, next_link, page_of
from service.web.api.deps import Context, json_response
from service.web.api.problems import parameter_problem
from service.web.api.trail import ChangeLine

router = APIRouter(prefix="/notifications", tags=["alarms"])
BODIES = (NotificationMessage,)
WEBHOOKS: Final = {
    "alarms": {
        "post": {
            "tags": ["alarms"],
            "summary": "Alarms that were raised, acknowledged, escalated or are gone",
            "description": "Sent to each webhook of `[[notifications]]`, with `webhook-id`, "
            "`webhook-timestamp` and `webhook-signature` of the Standard Webhooks specification. "
            "An event may come again; its `id` is the same then.",
            "requestBody": {
                "required": True,
                "content": {
                    "application/json": {
                        "schema": {"$ref": "#/components/schemas/NotificationMessage"}
                    }
                },
            },
            "responses": {"2XX": {"description": "Accepted. Anything else: it comes again."}},
        }
    }
}


@router.get("", response_model=NotificationList, summary="List notifications", **secured(VIEWER))
async def list_notifications(
    context: Context, request: Request, limit: Limit = LIMIT, cursor: Cursor = None
) -> Response:
    """Give the notifications of the configuration, and how each is."""
    states = {one.id: one for one in await context.cell(Notifications).states()}
    now_us = context.clock.now_us()
    sections = sections_of(context.settings).notifications
    page, following = page_of(sections, limit, cursor, lambda section: section.id)
    body = NotificationList(
        items=[_document(one, states.get(one.id), now_us) for one in page], next=following
    )
    return json_response(body, headers=next_link(request, following))


@router.post(
    "/{notification_id}:test",
    response_model=NotificationTest,
    summary="Send a test message",
    **secured(ENGINEER, 404, audit="notification.test"),
)
async def test_notification(
    context: Context,
    line: ChangeLine,
    notification_id: Annotated[
        str, Path(max_length=64, description="`id` of the notification.", examples=["control-room"])
    ],
) -> Response:
    """Send a message that says that it is a test, at once: quiet hours do not hold it back."""
    if all(one.id != notification_id for one in sections_of(context.settings).notifications):
        raise parameter_problem("notification_id", f"no notification {notification_id!r}", 404)
    sent, detail = await context.cell(Notifications).test(notification_id, line.who, line)
    return json_response(NotificationTest(told=sent, detail=detail or None))


def _document(
    section: NotificationSection, state: NotificationState | None, now_us: int
) -> NotificationDocument:
    state = state or NotificationState(section.id)
    quiet = section.quiet_hours
    return NotificationDocument(
        id=section.id,
        kind=section.kind,
        receivers=list(section.receivers),
        priorities=list(section.priorities),
        assets=list(section.assets),
        families=list(section.families),
        only_escalations=section.only_escalations,
        quiet=quiet is not None and is_within(quiet, (), now_us),
        waiting=state.waiting,
        held=state.held,
        told_at=time_or_none(state.sent_us),
        failing_since=time_or_none(state.failing_since_us),
        error=state.error or None,
        given_up=state.given_up,
    )
