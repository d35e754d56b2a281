"""Measurements: the history of channels, and the way in for gateways."""

import asyncio
import tempfile
from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from pydantic_core import to_json
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from adapters.tables import TableFileError
from service.api.access import secured
from service.api.bodies import Measurements, Pushed
from service.api.context import AssetTwin, ServiceContext
from service.api.cursors import decode_cursor, encode_cursor, next_link
from service.api.deps import Asset, Context, json_response
from service.api.problems import Problem, parameter_problem
from service.api.pushes import PushRequest, judge
from service.api.times import Instant
from service.security.roles import PUSH, VIEWER
from service.store import Rollup, StoredSample, StoreUnavailableError
from service.transfer.exporting import write_parquet
from service.transfer.pages import (
    Place,
    Resolution,
    as_csv,
    as_items,
    choose_resolution,
    csv_header,
    csv_lines,
    is_resolution,
    read_page,
)

LIMIT = 10_000
LIMIT_MAX = 50_000
CHANNELS_MAX = 50
PUSH_PATIENCE_S = 10.0
DEFAULT_SPAN_US = 3600 * 1_000_000
CSV = "text/csv; charset=utf-8"
PARQUET = "application/vnd.apache.parquet"
_CSV_PAGE_ROWS = 5000
_JSON_PIECE_ROWS = 1000
_CHUNK_BYTES = 1 << 18

router = APIRouter(prefix="/assets/{asset_id}/measurements", tags=["measurements"])


@router.get(
    "",
    response_model=Measurements,
    summary="History with quality",
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
def get_measurements(
    context: Context,
    asset: Asset,
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
            "answer with buckets in between; `resolution` of the answer tells."
        ),
    ] = "raw",
    format: Annotated[
        Literal["json", "csv", "parquet"],
        Query(
            description="`csv` without `limit`, and `parquet`, give the whole span in one file; "
            "`parquet` needs the extra `parquet`."
        ),
    ] = "json",
    limit: Annotated[int | None, Query(ge=1, le=LIMIT_MAX, description=f"{LIMIT} if absent.")] = (
        None
    ),
    cursor: Annotated[
        str | None,
        Query(max_length=8192, description="`next` of the page before; keeps its query."),
    ] = None,
) -> Response:
    """Ascending by time, then by channel; `start` is included, `end` is not."""
    if cursor is not None:
        place = decode_cursor(cursor, Place)
        if not is_resolution(place.resolution):
            raise parameter_problem("cursor", "expected the `next` of the page before")
    else:
        place = _new_query(context, asset, channel, start, end, resolution)
    if format == "csv" and limit is None:
        lines = csv_lines(context.store, asset.id, place, _CSV_PAGE_ROWS)
        return StreamingResponse(lines, media_type=CSV, headers=_file_name(asset))
    if format == "parquet":
        return _parquet(context, asset, place)
    page = read_page(context.store, asset.id, place, limit or LIMIT)
    following = None if page.following is None else encode_cursor(page.following)
    headers = next_link(request, following)
    if format == "csv":
        text = csv_header(place.resolution) + as_csv(page.rows)
        return Response(text, media_type=CSV, headers=headers | _file_name(asset))
    pieces = _json_pieces(place.resolution, page.rows, following)
    return StreamingResponse(pieces, media_type="application/json", headers=headers)


@router.post(
    "",
    response_model=Pushed,
    summary="Push samples",
    **secured(PUSH, 404, 409, audit=None),
)
async def post_measurements(context: Context, asset: Asset, request: PushRequest) -> Response:
    """Take in samples of pushed channels, each judged for itself; sending again does no harm.

    The answer means that what was taken is on the disk. The first good value of a time wins; a
    good one replaces a bad or uncertain one.
    """
    wired = {
        str(sample["channel"]): index
        for index, sample in reversed(list(enumerate(request.samples)))
        if isinstance(sample, dict) and _is_wired(asset, sample.get("channel"))
    }
    if wired:
        raise Problem(
            409,
            f"channel {', '.join(sorted(wired))}: comes from a source of its own and "
            'takes no pushes, expected channels with source = "push"',
            errors=[
                {
                    "pointer": f"/samples/{index}/channel",
                    "detail": f"{name} comes from {asset.channels[name]!r}",
                }
                for name, index in sorted(wired.items())
            ],
        )
    now_us, rate = context.clock.now_us(), context.clock.rate
    verdict = judge(request.samples, asset, now_us, rate, context.store.kept_from_us)
    context.ingest.refuse_too_old(verdict.too_old)
    try:
        async with asyncio.timeout(PUSH_PATIENCE_S):
            counts = await context.ingest.accept(verdict.samples)
    except TimeoutError as error:
        raise StoreUnavailableError("pushed samples are not on the disk yet") from error
    if counts.stored + counts.duplicates < len(verdict.samples):
        # The time from which samples are kept moved on meanwhile.
        verdict = judge(request.samples, asset, now_us, rate, context.store.kept_from_us)
    return json_response(
        {
            "accepted": counts.stored,
            "duplicates": counts.duplicates,
            "rejected": verdict.rejected,
        }
    )


def _json_pieces(
    resolution: str, rows: Sequence[StoredSample | Rollup], following: str | None
) -> Iterator[bytes]:
    """Give the answer piece by piece: of a long one memory holds no second copy as text."""
    yield b'{"resolution":' + to_json(resolution) + b',"items":['
    for begin in range(0, len(rows), _JSON_PIECE_ROWS):
        items = to_json(as_items(rows[begin : begin + _JSON_PIECE_ROWS]), inf_nan_mode="null")
        yield (b"," if begin else b"") + items[1:-1]
    yield b'],"next":' + to_json(following) + b"}"


def _is_wired(asset: AssetTwin, channel: object) -> bool:
    return isinstance(channel, str) and asset.channels.get(channel, "push") != "push"


def _new_query(
    context: ServiceContext,
    asset: AssetTwin,
    channels: list[str] | None,
    start_us: int | None,
    end_us: int | None,
    resolution: Resolution,
) -> Place:
    store = context.store
    if channels is not None:
        known = set(asset.channels) | set(store.channels(asset.id))
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
    chosen: str = resolution
    if resolution == "auto":
        chosen = choose_resolution(store, asset.id, channels, start_us, end_us)
    return Place(resolution=chosen, start_us=start_us, end_us=end_us, channels=channels)


def _parquet(context: ServiceContext, asset: AssetTwin, place: Place) -> Response:
    # On the disk first: the file of a long span is larger than what memory should hold.
    file = tempfile.TemporaryFile(suffix=".parquet")  # noqa: SIM115 - closed by `chunks`
    try:
        write_parquet(file, context.store, asset.id, place)
    except TableFileError as error:
        file.close()
        raise parameter_problem("format", f"{error}; expected json or csv") from None
    except BaseException:
        file.close()
        raise

    def chunks() -> Iterator[bytes]:
        with file:
            file.seek(0)
            while chunk := file.read(_CHUNK_BYTES):
                yield chunk

    return StreamingResponse(chunks(), media_type=PARQUET, headers=_file_name(asset, "parquet"))


def _file_name(asset: AssetTwin, suffix: str = "csv") -> dict[str, str]:
    return {"Content-Disposition": f'attachment; filename="{asset.id}-measurements.{suffix}"'}
