"""Writes MDF 4.

A bad value is NaN with its invalidation bit, as some readers know only one of the two.
"""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from adapters.samples import Quality
from service.domain.channels import unit_of
from service.store import Store, StoredSample
from service.transfer.mdf import QUALITY_SUFFIX, load_asammdf
from service.transfer.pages import RAW, ExportPosition, read_pages

PAGE_ROWS = 20_000
_SECOND_US = 1_000_000
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_COMPRESSED = 2
"""Transposed and deflated: what slow temperatures shrink most by."""


def write_mdf(file: BinaryIO, store: Store, asset: str, place: ExportPosition) -> int:
    """Write the rows of a query, a group per channel; returns how many rows.

    Samples have ``NAME`` and ``NAME.quality``; buckets their mean as ``NAME``, and ``NAME.min``,
    ``NAME.max`` and ``NAME.count`` besides. The file begins, in UTC, with the first of all rows.
    Raises `TableFileError` if asammdf is not installed.
    """
    asammdf = load_asammdf()
    names = place.channels or store.samples.channels(asset)
    rows = 0
    with asammdf.MDF(version="4.10") as mdf:
        start_us = _start_us(store, asset, place, names)
        mdf.header.start_time = _EPOCH + timedelta(microseconds=start_us)
        mdf.header.comment = asset
        for name in names:
            one = place.model_copy(update={"channels": [name]})
            table = _columns(store, asset, one)
            if not table[0].size:
                continue
            rows += table[0].size
            mdf.append(
                _signals(asammdf, name, table, start_us, place.resolution),
                comment=f"{asset}/{name}",
                common_timebase=True,
            )
        mdf.save(file, compression=_COMPRESSED)
    return rows


def _start_us(store: Store, asset: str, place: ExportPosition, names: Sequence[str]) -> int:
    """Give the whole second in which the first row lies."""
    first_us = []
    for name in names:
        one = place.model_copy(update={"channels": [name]})
        page = next(read_pages(store, asset, one, 1), ())
        first_us += [row.time_us for row in page[:1]]
    return min(first_us, default=0) // _SECOND_US * _SECOND_US


def _columns(store: Store, asset: str, place: ExportPosition) -> list[NDArray[Any]]:
    """Times, qualities, values of one channel; of buckets their extremes and counts too."""
    pages = []
    for page in read_pages(store, asset, place, PAGE_ROWS):
        if not page:
            continue
        columns = [
            (row.time_us, row.quality, row.value)
            if isinstance(row, StoredSample)
            else (row.time_us, row.quality, row.mean, row.min, row.max, row.good)
            for row in page
        ]
        kinds = (np.int64, np.uint8, *(len(columns[0]) - 2) * (np.float64,))
        pages.append(
            [
                np.array(one, kind)
                for one, kind in zip(zip(*columns, strict=True), kinds, strict=True)
            ]
        )
    if not pages:
        return [np.empty(0)] * 3
    return [np.concatenate(parts) for parts in zip(*pages, strict=True)]


def _signals(
    asammdf: Any, name: str, table: Sequence[NDArray[Any]], start_us: int, resolution: str
) -> list[Any]:
    time_us, quality, *values = table
    seconds = (time_us - start_us) / _SECOND_US
    bad = quality < Quality.UNCERTAIN
    endings = ("",) if resolution == RAW else ("", ".min", ".max", ".count")
    found = [
        asammdf.Signal(
            np.where(bad, np.nan, column),
            seconds,
            unit="" if ending == ".count" else unit_of(name),
            name=f"{name}{ending}",
            invalidation_bits=bad | np.isnan(column),
        )
        for ending, column in zip(endings, values, strict=True)
    ]
    found.append(asammdf.Signal(quality, seconds, name=f"{name}{QUALITY_SUFFIX}", comment="OPC DA"))
    return found
