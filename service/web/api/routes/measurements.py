"""Measurements: the history of channels, and the way in for gateways."""

import io
from collections.abc import AsyncIterator
from functools import partial
from typing import Annotated, Any, Literal, TypedDict

from fastapi import APIRouter, Query
from pydantic_core import to_json
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from adapters.tables import TableFileError
from service.documents.measurements import Measurements, Pushed
from service.documents.problems import FieldError
from service.domain.errors import PushRefusedError
from service.domain.roles import PUSH, VIEWER
from service.domain.times import Instant
from service.store import Store
from service.transfer.exporting import ParquetPages
from service.transfer.pages import (
    ExportPosition,
    Resolution,
    as_csv,
    as_items,
    choose_resolution,
    csv_header,
    is_resolution,
    read_page,
)
from service.web.api.access import secured
from service.web.api.context import ServiceContext
from service.web.api.cursors import decode_cursor, encode_cursor, next_link
from service.web.api.deps import Asset, Context, Recorded, RecordedAsset, json_response
from service.web.api.problems import Problem, parameter_problem
from service.web.api.pushes import (
    PUSH_PATIENCE_S,
    PushRequest,
    PushRoute,
    Verdict,
    clock_ahead_s,
    give_turn_back,
    in_thread,
    judge,
    refused,
)
from service.web.api.turns import (
    HeldResponse,
    Turns,
    caller_of,
    pieces_in_turn,
    turns_of,
    while_there,
)

LIMIT = 10_000
LIMIT_MAX = 50_000
CHANNELS_MAX = 50
DEFAULT_SPAN_US = 3600 * 1_000_000
CSV = "text/csv; charset=utf-8"
PARQUET = "application/vnd.apache.parquet"
_MEDIA_TYPES = {"json": "application/json", "csv": CSV, "parquet": PARQUET}
_CSV_PAGE_ROWS = 5000
_PARQUET_PAGE_ROWS = 10_000
_PIECE_ROWS = 1000

_PREFIX = "/assets/{asset_id}/measurements"

router = APIRouter(tags=["measurements"])
_pushing = APIRouter(route_class=PushRoute)


@router.get(
    _PREFIX,
    response_model=Measurements,
    summary="List measurements",
    **secured(
        VIEWER,
        404,
        responses={
            200: {
                "content": {
                    "text/csv": {
                        "schema": {"type": "string"},
                        "example": "time,channel,value,quality\r\n"
                        "2026-11-21T08:00:00.000Z,t_inner_ring_c,63.4,192\r\n",
                    },
                    PARQUET: {"schema": {"type": "string", "format": "binary"}},
                }
            }
        },
    ),
)
async def get_measurements(
    context: Context,
    asset: Recorded,
    request: Request,
    channel: Annotated[
        list[str] | None,
        Query(
            max_length=CHANNELS_MAX,
            description="Repeatable; absent: all channels. Estimates are `t_inner_ring_c.twin` "
            "and `t_outer_ring_c.twin`.",
            examples=["t_inner_ring_c"],
        ),
    ] = None,
    start: Annotated[
        Instant | None,
        Query(description="From this process time on; absent: one hour before the end."),
    ] = None,
    end: Annotated[
        Instant | None, Query(description="Before this process time; absent: now.")
    ] = None,
    resolution: Annotated[
        Resolution,
        Query(
            description="Raw samples, or buckets with mean, min, max and count of the good ones. "
            "`auto` takes the finest that gives about 1500 rows per channel at most and may "
            "answer with buckets in between; `resolution` of the answer names them."
        ),
    ] = "raw",
    format: Annotated[
        Literal["json", "csv", "parquet"],
        Query(
            description="`csv` without `limit`, and `parquet`, give the whole span in one file; "
            "`parquet` needs the extra `parquet`."
        ),
    ] = "json",
    received: Annotated[
        bool,
        Query(
            description="Also show when the service received each raw sample, as `received`; "
            "buckets have no such time."
        ),
    ] = False,
    limit: Annotated[int | None, Query(ge=1, le=LIMIT_MAX, description=f"{LIMIT} if absent.")] = (
        None
    ),
    cursor: Annotated[
        str | None,
        Query(max_length=8192, description="`next` of the page before; keeps its query."),
    ] = None,
) -> Response:
    """Ascending by time, then by channel; `start` is included, `end` is not."""
    turns, caller = turns_of(request), caller_of(request)
    if cursor is not None:
        place = decode_cursor(cursor, ExportPosition)
        if not is_resolution(place.resolution):
            raise parameter_problem("cursor", "expected the `next` of the page before")
    else:
        place = await turns.read(
            caller, _new_query, context, asset, channel, start, end, resolution, received
        )
    rows_max = None if format == "parquet" or (format == "csv" and limit is None) else limit
    if rows_max is None and format == "json":
        rows_max = LIMIT
    if rows_max is not None and rows_max <= LIMIT:
        reading = turns.read(caller, _page, context.store, asset.id, place, format, rows_max)
        page, following = await while_there(request, reading)
        return StreamingResponse(
            pieces_in_turn(page), **_options(request, asset, format, following)
        )
    await while_there(request, turns.long_reads.enter(caller))
    leave = partial(turns.long_reads.leave, caller)
    try:
        following = None
        pieces: AsyncIterator[bytes]
        if rows_max is not None:
            reading = turns.read(caller, _page, context.store, asset.id, place, format, rows_max)
            page, following = await while_there(request, reading)
            pieces = pieces_in_turn(page)
        elif format == "csv":
            pieces = _csv(turns, caller, context.store, asset.id, place)
        else:
            pieces = await _parquet(turns, caller, context.store, asset.id, place)
        return HeldResponse(pieces, leave, **_options(request, asset, format, following))
    except BaseException:
        leave()
        raise


@_pushing.post(
    _PREFIX,
    response_model=Pushed,
    summary="Push samples",
    **secured(PUSH, 404, 409, audit=None),
)
async def post_measurements(
    context: Context, asset: Asset, request: Request, body: PushRequest
) -> Response:
    """Accept samples of pushed channels, each checked separately; sending again is harmless.

    The answer means that what was taken is on the disk. The first good value of a time wins; a
    good one replaces a bad or uncertain one. `rejected` names every sample that was not taken; of
    many only the first 100 say why.
    """
    channels = asset.channels
    now_us, rate = context.clock.now_us(), context.clock.rate

    async def judged() -> Verdict:
        kept_from_us = context.ingest.kept_from_us
        given = (body.samples, asset.id, channels, now_us, kept_from_us)
        verdict: Verdict = await in_thread(request, len(body.samples), judge, *given)
        return verdict

    verdict = await judged()
    if verdict.wired:
        raise Problem(
            409,
            f"channel {', '.join(sorted(verdict.wired))}: comes from a source of its own and "
            'takes no pushes, expected channels with source = "push"',
            errors=[
                FieldError(
                    pointer=f"/samples/{index}/channel",
                    detail=f"{name} comes from {channels[name]!r}",
                )
                for name, index in sorted(verdict.wired.items())
            ],
        )
    await give_turn_back(request)
    try:
        counts = await context.ingest.accept(
            asset.id, verdict.samples, verdict.too_old, now_us, PUSH_PATIENCE_S
        )
    except PushRefusedError as error:
        raise refused(error) from error
    if counts.stored + counts.duplicates < len(verdict.samples):
        # The time from which samples are kept moved on meanwhile.
        verdict = await judged()
    newest_us = verdict.samples[-1].time_us if verdict.samples else None
    return json_response(
        Pushed(
            accepted=counts.stored,
            duplicates=counts.duplicates,
            rejected=verdict.rejected,
            clock_ahead_s=clock_ahead_s(newest_us, now_us, rate),
        )
    )


router.include_router(_pushing)


def _page(
    store: Store, asset: str, place: ExportPosition, format: str, rows_max: int
) -> tuple[list[bytes], str | None]:
    """One page of the answer, in pieces that are compressed one at a time, and the next cursor."""
    page = read_page(store, asset, place, rows_max)
    following = None if page.following is None else encode_cursor(page.following)
    begins = range(0, len(page.rows), _PIECE_ROWS)
    if format == "csv":
        texts = (as_csv(page.rows[begin : begin + _PIECE_ROWS], place).encode() for begin in begins)
        return [csv_header(place).encode(), *texts], following
    pieces = [b'{"resolution":' + to_json(place.resolution) + b',"items":[']
    for begin in begins:
        shown = as_items(page.rows[begin : begin + _PIECE_ROWS], place)
        items = to_json(shown, inf_nan_mode="null")
        pieces.append((b"," if begin else b"") + items[1:-1])
    return [*pieces, b'],"next":' + to_json(following) + b"}"], following


async def _csv(
    turns: Turns, caller: str, store: Store, asset: str, place: ExportPosition
) -> AsyncIterator[bytes]:
    """Give the whole answer of a query as CSV, page by page."""

    def read(place: ExportPosition) -> tuple[bytes, ExportPosition | None]:
        page = read_page(store, asset, place, _CSV_PAGE_ROWS)
        return as_csv(page.rows, place).encode(), page.following

    yield csv_header(place).encode()
    following: ExportPosition | None = place
    while following is not None:
        text, following = await turns.read(caller, read, following)
        yield text


async def _parquet(
    turns: Turns, caller: str, store: Store, asset: str, place: ExportPosition
) -> AsyncIterator[bytes]:
    """Give the whole answer of a query as Parquet, page by page; no file is needed for it."""
    sink = _Sink()

    def begin() -> ParquetPages:
        return ParquetPages(sink, asset, place, place.channels or store.samples.channels(asset))

    def write(place: ExportPosition) -> ExportPosition | None:
        page = read_page(store, asset, place, _PARQUET_PAGE_ROWS)
        file.write(page.rows)
        return page.following

    async def pieces() -> AsyncIterator[bytes]:
        following: ExportPosition | None = place
        while following is not None:
            following = await turns.read(caller, write, following)
            yield sink.take()
        await turns.read(caller, file.close)
        yield sink.take()

    try:
        file = await turns.read(caller, begin)
    except TableFileError as error:
        raise parameter_problem("format", f"{error}; expected json or csv") from None
    return pieces()


class _Sink(io.RawIOBase):
    """A file that hands on what was written to it."""

    def __init__(self) -> None:
        self._written = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self._written += data
        return len(data)

    def take(self) -> bytes:
        taken, self._written = bytes(self._written), bytearray()
        return taken


class _Made(TypedDict):
    media_type: str
    headers: dict[str, str]


def _options(request: Request, asset: RecordedAsset, format: str, following: str | None) -> _Made:
    """What the response is to be made with."""
    headers = dict(next_link(request, following))
    if format != "json":
        headers["Content-Disposition"] = f'attachment; filename="{asset.id}-measurements.{format}"'
    return {"media_type": _MEDIA_TYPES[format], "headers": headers}


def _new_query(
    context: ServiceContext,
    asset: RecordedAsset,
    channels: list[str] | None,
    start_us: int | None,
    end_us: int | None,
    resolution: Resolution,
    received: bool,
) -> ExportPosition:
    store = context.store
    if channels is not None:
        known = set(asset.channels) | set(store.samples.channels(asset.id))
        for name in channels:
            if name not in known:
                raise parameter_problem(
                    "channel", f"no channel {name!r}, expected one of {', '.join(sorted(known))}"
                )
        channels = list(dict.fromkeys(channels))
    end_us = context.clock.now_us() + 1 if end_us is None else end_us
    start_us = max(end_us - DEFAULT_SPAN_US, 0) if start_us is None else start_us
    if end_us <= start_us:
        raise parameter_problem("start", "expected a time before the end of the span")
    if received and resolution not in ("raw", "auto"):
        raise parameter_problem(
            "received", f"expected resolution raw or auto, {resolution} has no such time"
        )
    chosen: str = resolution
    if resolution == "auto":
        chosen = choose_resolution(store, asset.id, channels, start_us, end_us)
    return ExportPosition(
        resolution=chosen, start_us=start_us, end_us=end_us, channels=channels, received=received
    )
