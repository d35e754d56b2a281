"""Runs of a machine: listed, named, annotated, reported."""

from typing import Annotated, Final
from uuid import uuid4

from anyio import to_thread
from fastapi import APIRouter, Path, Query
from pydantic import AfterValidator, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from service.bus.replica import AssetReplica
from service.domain.daily_hours import TimeZone
from service.domain.errors import RequestRefusedError
from service.domain.requests import RequestBody
from service.domain.roles import OPERATOR, VIEWER
from service.domain.texts import OneLine
from service.domain.times import Instant
from service.features.runs import questions
from service.features.runs.documents import (
    AnnotationDocument,
    RunDetail,
    RunDocument,
    RunList,
    annotation_document,
    run_detail,
    run_document,
    run_list,
)
from service.features.runs.report.files import ReportError, ReportFormat, available_formats, require
from service.features.runs.runs import Annotation, Run, Runs
from service.web.api.access import secured
from service.web.api.context import ServiceContext
from service.web.api.cursors import Before, Cursor, decode_cursor, encode_cursor, next_link
from service.web.api.deps import Asset, Context, Recorded, RecordedAsset, json_response
from service.web.api.problems import parameter_problem
from service.web.api.trail import ChangeLine
from service.web.api.turns import caller_of, study, turns_of

_LIMIT: Final = 50
_LIMIT_MAX: Final = 500
_MOST_ANNOTATIONS: Final = 1000
_MEDIA_TYPES: Final[dict[ReportFormat, str]] = {
    "pdf": "application/pdf",
    "png": "image/png",
    "csv": "text/csv; charset=utf-8",
}
_BINARY: Final = {"schema": {"type": "string", "format": "binary"}}

router = APIRouter(prefix="/assets/{asset_id}/runs", tags=["runs"])


def _said(text: str) -> str:
    if not (text := text.strip()):
        raise ValueError("expected some words")
    return text


class RunChange(RequestBody):
    """What is to be changed of a run."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"name": "run-in, new grease"}]})

    name: Annotated[OneLine, Field(max_length=100), AfterValidator(str.strip)] = Field(
        description="One line; empty: no name.", examples=["run-in, new grease"]
    )


class AnnotationRequest(RequestBody):
    """What is noted of a moment of a run."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"time": "2026-11-21T09:12:30Z", "text": "noise at the outer ring"}]
        }
    )

    time: Instant = Field(description="Process time, within the run.")
    text: Annotated[OneLine, Field(min_length=1, max_length=500), AfterValidator(_said)] = Field(
        description="One line.", examples=["noise at the outer ring"]
    )


RunId = Annotated[str, Path(max_length=64, description="`id` of the run.")]


@router.get("", response_model=RunList, summary="List runs", **secured(VIEWER, 404))
async def list_runs(
    context: Context,
    asset: Recorded,
    request: Request,
    limit: Annotated[int, Query(ge=1, le=_LIMIT_MAX, description="Items of a page.")] = _LIMIT,
    cursor: Cursor = None,
) -> Response:
    """Latest first, found in the speed that is stored now, late data and imports included."""
    before = None if cursor is None else decode_cursor(cursor, Before).before
    now_us = context.clock.now_us()

    def read() -> RunList:
        if cursor is None:
            context.store.part(Runs).refresh(asset.id, now_us)
        page = context.store.part(Runs).page(asset.id, limit, before)
        following = page.next_cursor
        return run_list(
            page,
            None if following is None else encode_cursor(Before(before=following)),
            available_formats(),
        )

    answer = await turns_of(request).read(caller_of(request), read)
    return json_response(answer, headers=next_link(request, answer.next))


@router.get(
    "/{run_id}", response_model=RunDetail, summary="Get a run with its annotations",
    **secured(VIEWER, 404),
)  # fmt: skip
async def get_run(context: Context, asset: Recorded, request: Request, run_id: RunId) -> Response:
    """Give what is known of a run."""
    now_us = context.clock.now_us()

    def read() -> RunDetail:
        context.store.part(Runs).refresh(asset.id, now_us)
        run = _run(context, asset, run_id)
        end_us = now_us if run.end_us is None else run.end_us
        return run_detail(run, context.store.part(Runs).annotations(asset.id, run.start_us, end_us))

    return json_response(await turns_of(request).read(caller_of(request), read))


@router.patch(
    "/{run_id}", response_model=RunDocument, summary="Name a run",
    **secured(OPERATOR, 404, audit="run.name"),
)  # fmt: skip
async def name_run(
    context: Context, asset: Asset, line: ChangeLine, run_id: RunId, request: RunChange
) -> Response:
    """Give a run a name; an empty one takes it away."""

    def write() -> RunDocument:
        _run(context, asset, run_id)
        context.store.part(Runs).rename(asset.id, run_id, request.name, line.who, line)
        return run_document(_run(context, asset, run_id))

    return json_response(await to_thread.run_sync(write))


@router.post(
    "/{run_id}/annotations",
    response_model=AnnotationDocument,
    status_code=201,
    summary="Annotate a run",
    **secured(OPERATOR, 404, audit="annotation.add"),
)
async def add_annotation(
    context: Context, asset: Asset, line: ChangeLine, run_id: RunId, request: AnnotationRequest
) -> Response:
    """Note a text at a moment of a run; it stays at its time, whatever becomes of the run."""
    now_us = context.clock.now_us()
    annotation = Annotation(uuid4().hex, asset.id, request.time, request.text, line.who)

    def write() -> None:
        run = _run(context, asset, run_id)
        end_us = now_us if run.end_us is None else run.end_us
        if not run.start_us <= request.time <= end_us:
            raise RequestRefusedError("/time", "expected a time within the run")
        known = context.store.part(Runs).annotations(asset.id, run.start_us, end_us)
        if len(known) >= _MOST_ANNOTATIONS:
            raise RequestRefusedError(
                "/text", f"expected at most {_MOST_ANNOTATIONS} annotations of a run"
            )
        context.store.part(Runs).annotate(annotation, line)

    await to_thread.run_sync(write)
    return json_response(annotation_document(annotation), 201)


@router.delete(
    "/{run_id}/annotations/{annotation_id}",
    status_code=204,
    response_class=Response,
    summary="Remove an annotation",
    **secured(OPERATOR, 404, audit="annotation.remove"),
)
async def remove_annotation(
    context: Context,
    asset: Asset,
    line: ChangeLine,
    run_id: RunId,
    annotation_id: Annotated[str, Path(max_length=64, description="`id` of the annotation.")],
) -> Response:
    """Remove an annotation; the audit trail keeps that it was there."""

    def write() -> None:
        _run(context, asset, run_id)
        if not context.store.part(Runs).remove_annotation(asset.id, annotation_id, line):
            raise parameter_problem("annotation_id", f"no annotation {annotation_id!r}", 404)

    await to_thread.run_sync(write)
    return Response(status_code=204)


@router.get(
    "/{run_id}/report",
    response_class=Response,
    summary="Get the report of a run as PDF, PNG or CSV",
    **secured(
        VIEWER,
        404,
        responses={
            200: {
                "content": {
                    "application/pdf": _BINARY,
                    "image/png": _BINARY,
                    "text/csv": {
                        "schema": {"type": "string"},
                        "example": "Run,item,value\r\nRun,Asset,bench-1\r\n",
                    },
                }
            }
        },
    ),
)
async def get_report(
    context: Context,
    asset: Asset,
    request: Request,
    run_id: RunId,
    format: Annotated[
        ReportFormat,
        Query(description="`csv` has the tables alone; `pdf` and `png` need the extra `report`."),
    ] = "pdf",
    time_zone: Annotated[
        TimeZone,
        Query(
            max_length=64,
            description="On paper the local time of this zone stands next to UTC.",
            examples=["Europe/Berlin"],
        ),
    ] = "UTC",
) -> Response:
    """What was run, temperatures against limits and forecasts, alarms, models, quality of data.

    The same bytes for the same data. It is made in a process of its own.
    """
    try:
        require(format)
    except ReportError as error:
        raise parameter_problem("format", f"{error}; expected csv") from None
    now_us = context.clock.now_us()

    def find() -> Run:
        context.store.part(Runs).refresh(asset.id, now_us)
        return _run(context, asset, run_id)

    run = await turns_of(request).read(caller_of(request), find)
    what = "report", run.id, format, time_zone
    body = await study(request, asset, what, questions.report, run, format, now_us, time_zone)
    name = f"{asset.id}-{run.id}.{format}"
    disposition = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(body, media_type=_MEDIA_TYPES[format], headers=disposition)


def _run(context: ServiceContext, asset: AssetReplica | RecordedAsset, run_id: str) -> Run:
    if "\x00" not in run_id and (run := context.store.part(Runs).get(asset.id, run_id)) is not None:
        return run
    raise parameter_problem("run_id", f"no run {run_id!r}", 404)
