"""The way in for gateways that speak for many assets: JSON, and InfluxDB's line protocol."""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Final, Literal

from fastapi import APIRouter, Query
from pydantic import ConfigDict, Field, WithJsonSchema
from starlette.requests import Request
from starlette.responses import Response

from service.documents.measurements import Pushed
from service.documents.problems import FieldError
from service.domain.errors import PushRefusedError
from service.domain.requests import RequestBody
from service.domain.roles import PUSH
from service.features.gateways.judging import JudgedPush, judge_rows
from service.features.gateways.line_protocol import PRECISIONS, judge_lines
from service.store import WriteCounts
from service.web.api.access import secured
from service.web.api.context import ServiceContext
from service.web.api.deps import Context, json_response
from service.web.api.middleware import KIB, Upload
from service.web.api.problems import Problem
from service.web.api.pushes import (
    PUSH_PATIENCE_S,
    SAMPLES_MAX,
    Judge,
    PushRoute,
    clock_ahead_s,
    give_turn_back,
    in_thread,
    refused,
    sample_schema,
)

router = APIRouter(route_class=PushRoute, tags=["measurements"])
_LINES: Final = "text/plain"
UPLOADS = (
    Upload("/measurements", 4096 * KIB),
    Upload("/write", 4096 * KIB, (_LINES, "application/octet-stream", "")),
)
#: This many wrong lines are named.
_NAMED: Final = 100
_BYTES_OF_A_FIELD: Final = 25


class PushForMany(RequestBody):
    """Samples of pushed channels of any assets, in any order."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "samples": [
                        {
                            "asset": "rig-2",
                            "channel": "t_inner_ring_c",
                            "time": "2026-11-21T08:00:00Z",
                            "value": 63.4,
                        }
                    ]
                }
            ]
        },
    )

    samples: Annotated[
        list[Any],
        Field(max_length=SAMPLES_MAX),
        WithJsonSchema(
            {
                "type": "array",
                "maxItems": SAMPLES_MAX,
                "items": sample_schema(
                    {"asset": {"type": "string", "examples": ["rig-2"]}}, "SampleOfAnAsset"
                ),
            }
        ),
    ]


@router.post(
    "/measurements",
    response_model=Pushed,
    summary="Push samples of many assets",
    **secured(PUSH, audit=None),
)
async def post_samples_of_many(context: Context, request: Request, body: PushForMany) -> Response:
    """Accept samples of pushed channels, each checked separately; sending again is harmless.

    The answer means that what was accepted is on the disk. `rejected` names every sample that was
    not accepted by its place in the list; of many only the first 100 say why.
    """

    async def judged(judge: Judge) -> JudgedPush:
        given = (body.samples, _channels_of(context), judge)
        push: JudgedPush = await in_thread(request, len(body.samples), judge_rows, *given)
        return push

    now_us, rate = context.clock.now_us(), context.clock.rate
    counts, push = await _accept(context, request, now_us, judged)
    newest_us = max(push.samples.time_us, default=None)
    return json_response(
        Pushed(
            accepted=counts.stored,
            duplicates=counts.duplicates,
            rejected=push.rejected,
            clock_ahead_s=clock_ahead_s(newest_us, now_us, rate),
        )
    )


_writing = secured(PUSH, 400, audit=None)
_writing["openapi_extra"]["requestBody"] = {
    "required": True,
    "content": {
        _LINES: {
            "schema": {"type": "string"},
            "example": "rig-2,host=gateway t_inner_ring_c=63.4,speed_rpm=3000 1763712000000000000",
        }
    },
}


@router.post(
    "/write",
    status_code=204,
    response_class=Response,
    summary="Push InfluxDB line protocol",
    **_writing,
)
async def post_lines(
    context: Context,
    request: Request,
    precision: Annotated[
        Literal["ns", "n", "us", "u", "ms", "s", "m", "h"],
        Query(description="Unit of the times."),
    ] = "ns",
    db: Annotated[str, Query(description="Ignored; clients of InfluxDB 1 send it.")] = "",
    rp: Annotated[str, Query(description="Ignored, too.")] = "",
    consistency: Annotated[str, Query(description="Ignored, too.")] = "",
    bucket: Annotated[str, Query(description="Ignored; clients of InfluxDB 2 send it.")] = "",
    org: Annotated[str, Query(description="Ignored, too.")] = "",
    org_id: Annotated[str, Query(alias="orgID", description="Ignored, too.")] = "",
) -> Response:
    """Accept lines: the measurement is the asset, each field a pushed channel, tags are ignored.

    Answered when all is on the disk. Status 400 names the lines with a field that was not
    accepted; all other fields are stored. Sending again is harmless.
    """
    content = await request.body()
    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise Problem(400, f"line {line}: not UTF-8; nothing was stored") from None
    line_of: list[int] = []

    async def judged(judge: Judge) -> JudgedPush:
        nonlocal line_of
        given = (text, PRECISIONS[precision], _channels_of(context), judge, SAMPLES_MAX)
        size = len(content) // _BYTES_OF_A_FIELD
        push, line_of = await in_thread(request, size, judge_lines, *given)
        result: JudgedPush = push
        return result

    _, push = await _accept(context, request, context.clock.now_us(), judged)
    if push.rejected:
        raise _partial_write(push, line_of, text.count("\n") + 1)
    return Response(status_code=204)


def _partial_write(push: JudgedPush, line_of: list[int], lines: int) -> Problem:
    wrong: dict[int, str] = {}
    for one in push.rejected:
        wrong.setdefault(line_of[one.index], one.detail)
    first = min(wrong)
    detail = f"line {first}: {wrong[first]}"
    if push.count:
        detail += f"; partial write: {len(wrong)} of {lines} lines have a field that was not stored"
    named = sorted(wrong.items())[:_NAMED]
    errors = [FieldError(parameter=f"line {number}", detail=why) for number, why in named]
    return Problem(400, detail, errors=errors)


async def _accept(
    context: ServiceContext, request: Request, now_us: int, judged: Callable[[Judge], Any]
) -> tuple[WriteCounts, JudgedPush]:
    """Judge a push and store what is good of it."""

    async def again() -> JudgedPush:
        push: JudgedPush = await judged(Judge(now_us, context.ingest.kept_from_us))
        return push

    push = await again()
    request.state.changed_assets = push.samples.assets()
    await give_turn_back(request)
    try:
        counts, left = await context.ingest.accept_all(*push.packed, now_us, PUSH_PATIENCE_S)
    except PushRefusedError as error:
        raise refused(error) from error
    if left:
        push.leave(left)
    elif counts.stored + counts.duplicates < push.count:
        # The time from which samples are kept moved on meanwhile.
        push = await again()
    return counts, push


def _channels_of(context: ServiceContext) -> Callable[[str], Mapping[str, str] | None]:
    """Give the channels of each asset, read once for a push."""
    known: dict[str, Mapping[str, str] | None] = {}

    def channels_of(name: str) -> Mapping[str, str] | None:
        if name not in known:
            asset = context.assets.get(name)
            known[name] = None if asset is None else asset.channels
        return known[name]

    return channels_of
