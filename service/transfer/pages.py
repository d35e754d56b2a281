"""The history of channels in pages: raw samples, or buckets of a fitting length."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Literal, Self

from pydantic import BaseModel, Field

from service.clock import rfc3339_exact
from service.documents.measurements import (
    BucketItem,
    ReceivedSampleItem,
    SampleItem,
    sample_item,
)
from service.spreadsheets import quoted_cell
from service.store import Rollup, Store, StoredSample

Resolution = Literal["raw", "1s", "1min", "1h", "auto"]

AUTO_POINTS = 1500
_SECOND_US = 1_000_000
_BUCKETS = {
    "1s": 1, "2s": 2, "5s": 5, "10s": 10, "15s": 15, "30s": 30,
    "1min": 60, "2min": 120, "5min": 300, "10min": 600, "15min": 900, "30min": 1800,
    "1h": 3600, "2h": 7200, "3h": 10_800, "6h": 21_600, "12h": 43_200,
    "1d": 86_400, "7d": 604_800, "28d": 2_419_200,
}  # fmt: skip
RAW = "raw"


class ExportPosition(BaseModel):
    """A query and how far it has been answered; what a cursor holds.

    `received` adds to raw samples when they were received; buckets have no such time.
    """

    resolution: str = Field(max_length=8)
    start_us: int = Field(ge=0, lt=2**62)
    end_us: int = Field(ge=0, lt=2**62)
    channels: list[str] | None = Field(max_length=100)
    after: (
        tuple[Annotated[int, Field(ge=0, lt=2**62)], Annotated[str, Field(max_length=1000)]] | None
    ) = None
    received: bool = False

    @property
    def shows_received(self) -> bool:
        """Whether the rows have received times."""
        return self.received and self.resolution == RAW

    def behind(self, row: StoredSample | Rollup) -> Self:
        """Give the same query, answered up to and with this row."""
        return self.model_copy(update={"after": (row.time_us, row.channel)})


@dataclass(frozen=True, slots=True)
class PageOfHistory:
    """Rows in order, and where to go on; None when that was all."""

    rows: Sequence[StoredSample | Rollup]
    following: ExportPosition | None


def bucket_us(resolution: str) -> int:
    """Length of a bucket in microseconds."""
    return _BUCKETS[resolution] * _SECOND_US


def is_resolution(text: str) -> bool:
    """Whether a text names a resolution that `read_page` knows."""
    return text == RAW or text in _BUCKETS


def choose_resolution(
    store: Store, asset: str, channels: Sequence[str] | None, start_us: int, end_us: int
) -> str:
    """Find the finest resolution that gives about `AUTO_POINTS` rows per channel at most.

    Only the part of the span that holds samples counts.
    """
    found = store.samples.span(asset, channels, start_us, end_us, AUTO_POINTS + 1)
    kept_from_us = store.samples.raw_kept_from_us()
    if start_us >= kept_from_us and (found is None or found[2] <= AUTO_POINTS):
        return RAW
    # Where raw samples have expired, rollups may begin at the start of the span.
    first_us = start_us if start_us < kept_from_us or found is None else found[0]
    last_us = kept_from_us if found is None else found[1]
    span_us = min(last_us + 1, end_us) - first_us
    fitting = (name for name in _BUCKETS if span_us <= AUTO_POINTS * bucket_us(name))
    return next(fitting, list(_BUCKETS)[-1])


def read_page(store: Store, asset: str, place: ExportPosition, limit: int) -> PageOfHistory:
    """Read the next rows of a query, `limit` at most."""
    rows: Sequence[StoredSample | Rollup]
    span = (place.start_us, place.end_us)
    if place.resolution == RAW:
        rows = store.samples.read(asset, place.channels, *span, limit + 1, place.after)
    else:
        bucket = bucket_us(place.resolution)
        rows = store.history.read(asset, place.channels, *span, bucket, limit + 1, place.after)
    if len(rows) <= limit:
        return PageOfHistory(rows, None)
    rows = rows[:limit]
    return PageOfHistory(rows, place.behind(rows[-1]))


def read_pages(
    store: Store, asset: str, place: ExportPosition, page_rows: int
) -> Iterator[Sequence[StoredSample | Rollup]]:
    """Read all rows of a query, page by page, so that memory stays small."""
    following: ExportPosition | None = place
    while following is not None:
        page = read_page(store, asset, following, page_rows)
        yield page.rows
        following = page.following


#: Rows of all channels at one time follow each other.
_time = lru_cache(1)(rfc3339_exact)


def as_items(
    rows: Sequence[StoredSample | Rollup], place: ExportPosition
) -> list[SampleItem | ReceivedSampleItem | BucketItem]:
    """Rows of a query as the JSON answer shows them."""
    received = place.shows_received
    return [
        _sample_item(row, received)
        if isinstance(row, StoredSample)
        else {
            "channel": row.channel,
            "time": _time(row.time_us),
            "mean": row.mean,
            "min": row.min,
            "max": row.max,
            "count": row.good,
            "quality": row.quality,
        }
        for row in rows
    ]


def csv_header(place: ExportPosition) -> str:
    """First line of the CSV answer to a query."""
    values = "value" if place.resolution == RAW else "mean,min,max,count"
    received = ",received" if place.shows_received else ""
    return f"time,channel,{values},quality{received}\r\n"


def as_csv(rows: Sequence[StoredSample | Rollup], place: ExportPosition) -> str:
    """Rows of a query as lines of the CSV answer; what is absent is an empty cell."""
    received = place.shows_received
    return "".join(
        f"{rfc3339_exact(row.time_us)},{quoted_cell(row.channel)},{_cell(row.value)},{row.quality}"
        f"{_received_cell(row) if received else ''}\r\n"
        if isinstance(row, StoredSample)
        else f"{_time(row.time_us)},{quoted_cell(row.channel)},{_cell(row.mean)},"
        f"{_cell(row.min)},{_cell(row.max)},{row.good},{row.quality}\r\n"
        for row in rows
    )


def _sample_item(row: StoredSample, received: bool) -> SampleItem | ReceivedSampleItem:
    item = sample_item(row.channel, row.time_us, row.value, row.quality)
    if not received:
        return item
    time_us = row.received_us
    return {**item, "received": None if time_us is None else rfc3339_exact(time_us)}


def _received_cell(row: StoredSample) -> str:
    return "," if row.received_us is None else f",{rfc3339_exact(row.received_us)}"


def _cell(value: float | None) -> str:
    return "" if value is None else repr(value)
