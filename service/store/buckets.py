"""Statistics of samples per bucket of time, as SQL."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from sqlalchemy import ColumnElement, Connection, Select, case, func, select

from adapters.samples import Quality
from service.store import packed
from service.store.blocks import Samples
from service.store.tables import RollupRow, SampleRow

#: Lengths of the buckets that are kept computed, coarsest first; each divides the one before.
LEVELS_S = (3600, 600, 60)

good_value = case((SampleRow.quality >= Quality.GOOD, SampleRow.value))
mean_of_good = func.avg(good_value)
count_of_good = func.count(good_value)


BucketQuery = Select[int, float | None, float | None, float | None, int, int]


class Bucket(NamedTuple):
    """One bucket of one channel.

    ``good`` counts the good samples; without any the statistics are None and ``quality`` is the
    worst of the bucket.
    """

    time_us: int
    mean: float | None
    low: float | None
    high: float | None
    good: int
    quality: int


def bucket_start(
    time_us: ColumnElement[int], bucket_us: int, offset_us: int = 0
) -> ColumnElement[int]:
    """Start of the bucket that a time belongs to."""
    return time_us - (time_us - offset_us) % bucket_us


def of_samples(channel_id: int, begin_us: int, end_us: int, bucket_us: int) -> BucketQuery:
    """Select the buckets of a span from the raw samples, in the columns of `Bucket`."""
    start = bucket_start(SampleRow.time_us.expression, bucket_us)
    return (
        select(
            start,
            mean_of_good,
            func.min(good_value),
            func.max(good_value),
            count_of_good,
            case((count_of_good > 0, int(Quality.GOOD)), else_=func.min(SampleRow.quality)),
        )
        .where(
            SampleRow.channel_id == channel_id,
            SampleRow.time_us >= begin_us,
            SampleRow.time_us < end_us,
        )
        .group_by(start)
    )


def of_block(samples: Samples, bucket_us: int, offset_us: int = 0) -> list[tuple[Bucket, int]]:
    """Compute the buckets of packed samples, and how many samples of any quality each has."""
    times_us, values, qualities, _ = samples
    if not times_us.size:
        return []
    starts_us = times_us - (times_us - offset_us) % bucket_us
    first = np.flatnonzero(np.diff(starts_us, prepend=starts_us[0] - 1))
    counts = np.diff(np.append(first, times_us.size))
    is_good = (qualities >= Quality.GOOD) & ~np.isnan(values)
    good = np.add.reduceat(is_good, first, dtype=np.int64)
    total = np.add.reduceat(np.where(is_good, values, 0.0), first)
    low = np.minimum.reduceat(np.where(is_good, values, np.inf), first)
    high = np.maximum.reduceat(np.where(is_good, values, -np.inf), first)
    worst = np.minimum.reduceat(qualities, first)
    found = []
    for number, start in enumerate(starts_us[first].tolist()):
        if count := int(good[number]):
            mean = float(total[number] / count)
            extremes = (mean, float(low[number]), float(high[number]))
            bucket = Bucket(start, *extremes, count, int(Quality.GOOD))
        else:
            bucket = Bucket(start, None, None, None, 0, int(worst[number]))
        found.append((bucket, int(counts[number])))
    return found


def of_raw(
    connection: Connection, channel_id: int, begin_us: int, end_us: int, bucket_us: int
) -> list[Bucket]:
    """Compute the buckets of a span from all raw samples, those in the table and those in blocks.

    A bucket that reaches over the end of an hour may come in two parts, see `merged`.
    """
    parts = read(connection, of_samples(channel_id, begin_us, end_us, bucket_us))
    for samples in packed.read(connection, channel_id, begin_us, end_us):
        parts += [bucket for bucket, _ in of_block(samples, bucket_us)]
    return merged(parts)


def of_rollups(
    channel_id: int, resolution_s: int, begin_us: int, end_us: int, bucket_us: int
) -> BucketQuery:
    """Select the buckets of a span from finer or equal rollups, in the columns of `Bucket`."""
    start = bucket_start(RollupRow.time_us.expression, bucket_us)
    good = func.sum(RollupRow.good)
    return (
        select(
            start,
            func.sum(RollupRow.mean * RollupRow.good) / func.nullif(good, 0),
            func.min(RollupRow.low),
            func.max(RollupRow.high),
            good,
            case((good > 0, int(Quality.GOOD)), else_=func.min(RollupRow.quality)),
        )
        .where(
            RollupRow.channel_id == channel_id,
            RollupRow.resolution_s == resolution_s,
            RollupRow.time_us >= begin_us,
            RollupRow.time_us < end_us,
        )
        .group_by(start)
    )


def read(connection: Connection, query: BucketQuery) -> list[Bucket]:
    """Run one of the queries above."""
    return [Bucket(*row) for row in connection.execute(query).all()]


def merged(parts: Iterable[Bucket]) -> list[Bucket]:
    """Join parts of the same bucket; ascending by time."""
    found: dict[int, Bucket] = {}
    for part in parts:
        other = found.get(part.time_us)
        found[part.time_us] = part if other is None else _joined(other, part)
    return sorted(found.values())


def _joined(a: Bucket, b: Bucket) -> Bucket:
    if not (a.good and b.good):
        worst = min(a.quality, b.quality)
        return max(a, b, key=lambda one: one.good)._replace(
            quality=int(Quality.GOOD) if a.good or b.good else worst
        )
    good = a.good + b.good
    assert a.mean is not None and b.mean is not None  # noqa: PT018, S101 - both have good samples
    assert a.low is not None and b.low is not None  # noqa: PT018, S101
    assert a.high is not None and b.high is not None  # noqa: PT018, S101
    mean = (a.mean * a.good + b.mean * b.good) / good
    return Bucket(a.time_us, mean, min(a.low, b.low), max(a.high, b.high), good, int(Quality.GOOD))
