"""What happened to alarms: the journal, and the load that alarms are on operators."""

import csv
import io
from collections.abc import AsyncIterator
from functools import partial
from typing import Annotated, Literal

from anyio import to_thread
from fastapi import APIRouter, Query
from pydantic import BaseModel, Field
from starlette.requests import Request
from starlette.responses import Response

from service.documents.alarms import (
    AlarmJournalLine,
    AlarmJournalList,
    AlarmStatistics,
    statistics_document,
    transition_document,
)
from service.domain.roles import VIEWER
from service.domain.texts import visible
from service.domain.times import Instant
from service.spreadsheets import cell
from service.store import AlarmJournalPage, JournalFilter, Store
from service.web.api.access import secured
from service.web.api.cursors import decode_cursor, encode_cursor, next_link
from service.web.api.deps import AssetFilter, Context, RecordedFilter, json_response
from service.web.api.problems import parameter_problem
from service.web.api.turns import HeldResponse, Turns, caller_of, turns_of, while_there

LIMIT = 100
LIMIT_MAX = 1000
CSV = "text/csv; charset=utf-8"
_FLUSH_S = 1.0
_COLUMNS = (
    "time", "class", "asset", "kind", "channel", "limit_level", "priority", "event", "from", "to",
    "who", "comment", "shelved_until", "value", "peak_value", "peak_time", "duration_s", "message",
    "alarm_id", "assets",
)  # fmt: skip

router = APIRouter(prefix="/alarms", tags=["alarms"])


class JournalPlace(BaseModel):
    """Where a page of the journal ended."""

    before: int = Field(ge=0, lt=2**63)


@router.get(
    "/journal",
    response_model=AlarmJournalList,
    summary="List the alarm journal",
    **secured(
        VIEWER,
        503,
        responses={
            200: {
                "content": {
                    "text/csv": {
                        "schema": {"type": "string"},
                        "example": ",".join(_COLUMNS)
                        + "\r\n2026-11-21T08:00:00.000Z,alarm,bench-1,measured limit,"
                        "t_inner_ring_c,warning,2,acknowledge,UNACK,ACKED,operator bt_1a2b3c4d,"
                        "load is being reduced,,91.5,93.2,2026-11-21T07:58:12.000Z,,"
                        "Inner ring over warning 90 °C,5d0c9a3e\r\n",
                    }
                }
            }
        },
    ),
)
async def get_journal(
    context: Context,
    request: Request,
    asset: RecordedFilter,
    alarm: Annotated[
        str | None, Query(max_length=64, description="Only of the alarm of this id.")
    ] = None,
    start: Annotated[Instant | None, Query(description="From this process time on.")] = None,
    end: Annotated[Instant | None, Query(description="Before this process time.")] = None,
    line_class: Annotated[
        Literal["alarm", "event"] | None,
        Query(alias="class", description="Only lines of alarms, or only events."),
    ] = None,
    format: Annotated[
        Literal["json", "csv"],
        Query(description="`csv` without `limit` gives all lines in one file."),
    ] = "json",
    limit: Annotated[
        int | None, Query(ge=1, le=LIMIT_MAX, description=f"{LIMIT} if absent.")
    ] = None,
    cursor: Annotated[str | None, Query(description="`next` of the page before.")] = None,
) -> Response:
    """Newest first: what happened, with who and why; events have no alarm."""
    if start is not None and end is not None and end <= start:
        raise parameter_problem("end", "expected a time later than start")
    before = None if cursor is None else decode_cursor(cursor, JournalPlace).before
    wanted = JournalFilter(
        asset, alarm, start, end, None if line_class is None else line_class == "event"
    )
    # What an operator has just done is in the answer.
    await context.cell.flush_alarms(_FLUSH_S)
    turns, caller = turns_of(request), caller_of(request)
    if format == "csv" and limit is None:
        await while_there(request, turns.long_reads.enter(caller))
        pages = _pages(turns, caller, context.store, wanted, before)
        leave = partial(turns.long_reads.leave, caller)
        return HeldResponse(pages, leave, media_type=CSV, headers=_FILE)
    page = await turns.read(caller, context.store.alarms.journal, wanted, limit or LIMIT, before)
    following = None
    if page.next_cursor is not None:
        following = encode_cursor(JournalPlace(before=page.next_cursor))
    headers = next_link(request, following)
    if format == "csv":
        text = _csv([_COLUMNS]) + _csv_lines(page)
        return Response(text, media_type=CSV, headers=headers | _FILE)
    items = [transition_document(line, page.units.get(line.alarm_id)) for line in page.items]
    return json_response(AlarmJournalList(items=items, next=following), headers=headers)


@router.get(
    "/statistics",
    response_model=AlarmStatistics,
    summary="Get alarm statistics",
    **secured(VIEWER, 503),
)
async def get_statistics(
    context: Context,
    asset: AssetFilter,
) -> Response:
    """Alarms raised in the last 10 minutes and the last day, the most frequent, those that stay.

    An alarm counts every time that it becomes unacknowledged on its own; process time.
    """
    await context.cell.flush_alarms(_FLUSH_S)
    now_us = context.clock.now_us()
    counts = await to_thread.run_sync(context.store.alarms.annunciations, now_us, asset)
    alarms = await context.cell.open_alarms(asset)
    return json_response(statistics_document(counts, alarms, now_us))


_FILE = {"Content-Disposition": 'attachment; filename="alarm-journal.csv"'}


async def _pages(
    turns: Turns, caller: str, store: Store, wanted: JournalFilter, before: int | None
) -> AsyncIterator[str]:
    def read(before: int | None) -> tuple[str, int | None]:
        page = store.alarms.journal(wanted, LIMIT_MAX, before)
        return _csv_lines(page), page.next_cursor

    yield _csv([_COLUMNS])
    while True:
        text, before = await turns.read(caller, read, before)
        yield text
        if before is None:
            return


def _csv_lines(page: AlarmJournalPage) -> str:
    documents = [
        _flat(transition_document(line, page.units.get(line.alarm_id))) for line in page.items
    ]
    return _csv([tuple(document[name] for name in _COLUMNS) for document in documents])


def _flat(line: AlarmJournalLine) -> dict[str, object]:
    peak = {} if line.peak is None else {"peak_value": line.peak.value, "peak_time": line.peak.time}
    assets = {"assets": " ".join(line.assets)}
    others = line.model_dump(exclude={"peak", "assets"})
    return {"peak_value": None, "peak_time": None} | others | assets | peak


def _visible(value: object) -> object:
    return visible(value) if isinstance(value, str) else value


def _csv(rows: list[tuple[object, ...]]) -> str:
    text = io.StringIO()
    csv.writer(text).writerows([[cell(_visible(value)) for value in row] for row in rows])
    return text.getvalue()
