"""Silences: planned times without notifications of alarms."""

from functools import partial
from typing import Annotated, Any, Final, Literal
from uuid import uuid4

from anyio import to_thread
from fastapi import APIRouter, Path
from pydantic import ConfigDict, Field, ValidationError
from starlette.requests import Request
from starlette.responses import Response

from service.clock import DAY_US, rfc3339
from service.domain.daily_hours import DailyHours
from service.domain.errors import RequestRefusedError
from service.domain.requests import RequestBody
from service.domain.roles import ENGINEER, OPERATOR, VIEWER
from service.domain.texts import OneLine
from service.domain.times import Instant
from service.features.silences.documents import (
    EndedSilences,
    SilenceDocument,
    SilenceList,
    WeeklyHours,
)
from service.features.silences.silence_times import is_in_force
from service.features.silences.tables import Silence, Silences, TooManySilencesError
from service.web.api.access import Caller, secured
from service.web.api.cursors import LIMIT, Cursor, Limit, next_link, page_of
from service.web.api.deps import Context, json_response
from service.web.api.problems import Problem, parameter_problem, pointer_problem
from service.web.api.trail import ChangeLine

_DAYS: Final = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
_LONGEST_DAYS: Final = 366
#: An operator silences all assets for so many days at most.
_OF_ALL_DAYS: Final = 1
_MOST_ENDED: Final = 200
_TIME: Final = r"^([01]\d|2[0-3]):[0-5]\d$"

router = APIRouter(prefix="/silences", tags=["alarms"])


class WeeklyRequest(RequestBody):
    """Hours of a silence on a schedule."""

    days: list[Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]] = Field(
        [], max_length=7, description="Days on which it begins; absent: all."
    )
    begins: str = Field(pattern=_TIME, examples=["22:00"])
    ends: str = Field(
        pattern=_TIME, description="Of the next day where not later.", examples=["06:00"]
    )
    time_zone: str = Field("UTC", max_length=64, examples=["Europe/Berlin"])


class SilenceRequest(RequestBody):
    """Whose alarms are not sent, until when, and why."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "assets": ["bench-1"],
                    "ends_at": "2026-11-22T14:00:00Z",
                    "comment": "bearing is being regreased",
                }
            ]
        }
    )

    assets: list[Annotated[str, Field(min_length=1, max_length=200)]] = Field(
        [], max_length=500, description="Ids; absent: all."
    )
    begins_at: Instant | None = Field(None, description="Process time; absent: now.")
    ends_at: Instant = Field(description=f"Process time, at most {_LONGEST_DAYS} days from now.")
    weekly: WeeklyRequest | None = Field(None, description="Only in these hours.")
    comment: Annotated[OneLine, Field(min_length=1, max_length=500, description="Why.")]


class EndRequest(RequestBody):
    """Which silences end."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"ids": ["7d1f0c9a3e7b4f2a9c8d7e6f5a4b3c2d"]}]}
    )

    ids: list[Annotated[str, Field(min_length=1, max_length=64)]] = Field(
        min_length=1, max_length=_MOST_ENDED
    )


@router.get("", response_model=SilenceList, summary="List silences", **secured(VIEWER))
async def list_silences(
    context: Context, request: Request, limit: Limit = LIMIT, cursor: Cursor = None
) -> Response:
    """Give the silences that are not over: in force, planned, or on a schedule."""
    now_us = context.clock.now_us()
    silences = await to_thread.run_sync(context.store.part(Silences).load, now_us)
    page, following = page_of(silences, limit, cursor, lambda silence: silence.id)
    body = SilenceList(items=[_document(one, now_us) for one in page], next=following)
    return json_response(body, headers=next_link(request, following))


@router.post(
    "",
    response_model=SilenceDocument,
    status_code=201,
    summary="Create a silence",
    **secured(OPERATOR, 409, audit="silence.begin"),
)
async def add_silence(
    context: Context, who: Caller, line: ChangeLine, request: SilenceRequest
) -> Response:
    """Plan a silence. Alarms are raised and listed as usual; those active at its end are sent.

    It holds back e-mail and webhooks of all priorities, escalation too, within two seconds. At most
    200 are in force or planned at a time. One of all assets that lasts longer than a day, also on a
    schedule, asks for an engineer: it holds back priority 1 of every machine.
    """
    now_us = context.clock.now_us()
    unknown = [one for one in request.assets if one not in context.assets]
    if unknown and not context.is_known(unknown[0]):
        raise RequestRefusedError("/assets", f"no asset {unknown[0]!r}")
    begins_us = now_us if request.begins_at is None else request.begins_at
    if request.ends_at <= max(begins_us, now_us):
        raise RequestRefusedError("/ends_at", "expected a time in the future, after begins_at")
    if request.ends_at > now_us + _LONGEST_DAYS * DAY_US:
        raise RequestRefusedError("/ends_at", f"expected at most {_LONGEST_DAYS} days from now")
    named = set(request.assets)
    of_all = not named or 1 < len(context.assets) <= len(named & context.assets.keys())
    longest_us = _OF_ALL_DAYS * DAY_US
    if of_all and request.ends_at - begins_us > longest_us and who.role not in ENGINEER:
        raise Problem(
            403,
            f"a key of role {who.role} silences all assets for {24 * _OF_ALL_DAYS} h at most, "
            "priority 1 included; expected an earlier end, some of the assets, or the key of an "
            "engineer",
        )
    silence = Silence(
        id=uuid4().hex,
        assets=tuple(dict.fromkeys(request.assets)),
        begins_us=begins_us,
        ends_us=request.ends_at,
        who=line.who,
        comment=request.comment,
        **_weekly(request.weekly),
    )
    try:
        await to_thread.run_sync(partial(context.store.part(Silences).add, silence, now_us, line))
    except TooManySilencesError as error:
        raise Problem(409, str(error)) from error
    return json_response(_document(silence, now_us), 201)


@router.post(
    "/end",
    response_model=EndedSilences,
    summary="End several silences early",
    **secured(OPERATOR, 404, audit="silence.end"),
)
async def end_silences(context: Context, line: ChangeLine, request: EndRequest) -> Response:
    """Alarms that are still active are sent now. `unknown` names ids without a silence."""
    ids = list(dict.fromkeys(request.ids))
    ended = set(await to_thread.run_sync(context.store.part(Silences).end, ids, line))
    if not ended:
        raise pointer_problem("/ids", "no silence of these ids", 404)
    return json_response(
        EndedSilences(
            ended=[one for one in ids if one in ended],
            unknown=[one for one in ids if one not in ended],
        )
    )


@router.delete(
    "/{silence_id}",
    status_code=204,
    response_class=Response,
    summary="End a silence early",
    **secured(OPERATOR, 404, audit="silence.end"),
)
async def end_silence(
    context: Context,
    line: ChangeLine,
    silence_id: Annotated[str, Path(max_length=64, description="`id` of the silence.")],
) -> Response:
    """Alarms that are still active are sent now."""
    if not await to_thread.run_sync(context.store.part(Silences).end, [silence_id], line):
        raise parameter_problem("silence_id", f"no silence {silence_id!r}", 404)
    return Response(status_code=204)


def _weekly(weekly: WeeklyRequest | None) -> dict[str, Any]:
    if weekly is None:
        return {}
    hours = {"begins": weekly.begins, "ends": weekly.ends, "time_zone": weekly.time_zone}
    try:
        DailyHours.model_validate(hours)
    except ValidationError as error:
        said = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise RequestRefusedError("/weekly", said) from error
    return hours | {"days": tuple(sorted(_DAYS.index(day) for day in set(weekly.days)))}


def _document(silence: Silence, now_us: int) -> SilenceDocument:
    weekly = None
    if silence.begins:
        weekly = WeeklyHours(
            days=[_DAYS[day] for day in silence.days],
            begins=silence.begins,
            ends=silence.ends,
            time_zone=silence.time_zone,
        )
    return SilenceDocument(
        id=silence.id,
        assets=list(silence.assets),
        begins_at=rfc3339(silence.begins_us),
        ends_at=rfc3339(silence.ends_us),
        weekly=weekly,
        in_force=is_in_force(silence, now_us),
        who=silence.who,
        comment=silence.comment,
    )
