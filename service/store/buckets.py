"""Statistics of samples per bucket of time, as SQL."""

from collections.abc import Iterable
from functools import partial
from itertools import islice
from operator import lt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, Select, case, func, select

from adapters.samples import Quality
from service.store import packed
from service.store.blocks import ChannelSamples
from service.store.rollup_blocks import Buckets
from service.store.tables import RollupRow, SampleRow

#: Lengths of the buckets that are kept computed, coarsest first; each divides the one before.
LEVELS_S = (3600, 600, 60)

good_value = case((SampleRow.quality >= Quality.GOOD, SampleRow.value))
mean_of_good = func.avg(good_value)
count_of_good = func.count(good_value)


#: Means above are multiplied by the other, a power of two, before they are added up.
_LARGE, _SCALE = 1e290, 2.0**-60

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


#: Of six columns; `Bucket._make` would be a step of the program for each.
_bucket = partial(tuple.__new__, Bucket)


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


class Statistics(NamedTuple):
    """Buckets of samples.

    ``first`` is where in the samples each bucket begins, ``counts`` are of samples of any quality.
    """

    first: NDArray[np.int64]
    buckets: Buckets
    counts: NDArray[np.int64]


def statistics(
    samples: ChannelSamples,
    bucket_us: int,
    offset_us: int = 0,
    channel_ids: NDArray[np.int64] | None = None,
) -> Statistics:
    """Compute the buckets of samples, which are at least one.

    ``channel_ids``: of each sample, ascending, where they are of several channels.
    """
    times_us, values, qualities, _ = samples
    starts_us = times_us - (times_us - offset_us) % bucket_us
    begins = np.diff(starts_us, prepend=starts_us[0] - 1) != 0
    if channel_ids is not None:
        begins |= np.diff(channel_ids, prepend=channel_ids[0]) != 0
    first = np.flatnonzero(begins)
    is_good = (qualities >= Quality.GOOD) & ~np.isnan(values)
    good = np.add.reduceat(is_good, first, dtype=np.int64)
    means = _means(np.where(is_good, values, 0.0), is_good.astype(np.int64), first)
    low = np.minimum.reduceat(np.where(is_good, values, np.inf), first)
    high = np.maximum.reduceat(np.where(is_good, values, -np.inf), first)
    worst = np.minimum.reduceat(qualities, first)
    return Statistics(
        first,
        Buckets(
            starts_us[first],
            np.where(good > 0, means, np.nan),
            np.where(good > 0, low, np.nan),
            np.where(good > 0, high, np.nan),
            good,
            np.where(good > 0, np.uint16(Quality.GOOD), worst),
        ),
        np.diff(np.append(first, times_us.size)),
    )


def _means(
    values: NDArray[np.float64], weights: NDArray[np.int64], first: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Compute the weighted means of groups, 0 where there is no weight."""
    totals = np.maximum(np.add.reduceat(weights, first), 1)
    with np.errstate(over="ignore", invalid="ignore"):
        means: NDArray[np.float64] = np.add.reduceat(values * weights, first) / totals
    if not np.isfinite(means).all():  # the sum is too large, the mean is not
        shares = weights / np.repeat(totals, np.diff(np.append(first, values.size)))
        means = np.where(np.isfinite(means), means, np.add.reduceat(values * shares, first))
    return means


def joined(finer: Buckets, bucket_us: int) -> Buckets:
    """Join buckets that lie in the same one of this length."""
    times_us, means, lows, highs, good, qualities = finer
    if not times_us.size:
        return finer
    starts_us = times_us - times_us % bucket_us
    first = np.flatnonzero(np.diff(starts_us, prepend=starts_us[0] - 1))
    if first.size == times_us.size:
        return finer._replace(times_us=starts_us)
    total = np.add.reduceat(good, first)
    is_good = total > 0
    some = good > 0
    return Buckets(
        starts_us[first],
        np.where(is_good, _means(np.where(some, means, 0.0), good, first), np.nan),
        np.where(is_good, np.minimum.reduceat(np.where(some, lows, np.inf), first), np.nan),
        np.where(is_good, np.maximum.reduceat(np.where(some, highs, -np.inf), first), np.nan),
        total,
        np.where(is_good, np.uint16(Quality.GOOD), np.minimum.reduceat(qualities, first)),
    )


def listed(buckets: Buckets) -> list[Bucket]:
    """Give columns as buckets one by one."""
    return [
        Bucket(time_us, mean, low, high, good, quality)
        if good
        else Bucket(time_us, None, None, None, 0, quality)
        for time_us, mean, low, high, good, quality in zip(
            *(column.tolist() for column in buckets), strict=True
        )
    ]


def of_block(
    samples: ChannelSamples, bucket_us: int, offset_us: int = 0
) -> list[tuple[Bucket, int]]:
    """Compute the buckets of packed samples, and how many samples of any quality each has."""
    if not samples.times_us.size:
        return []
    found = statistics(samples, bucket_us, offset_us)
    return list(zip(listed(found.buckets), found.counts.tolist(), strict=True))


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
    """Select the buckets of a span from rows of finer or equal rollups: columns of `Bucket`."""
    within = (
        RollupRow.channel_id == channel_id,
        RollupRow.resolution_s == resolution_s,
        RollupRow.time_us >= begin_us,
        RollupRow.time_us < end_us,
    )
    if bucket_us == resolution_s * 1_000_000:
        return (
            select(
                RollupRow.time_us, RollupRow.mean, RollupRow.low, RollupRow.high,
                RollupRow.good, RollupRow.quality,
            )
            .where(*within)
            .order_by(RollupRow.time_us)
        )  # fmt: skip
    start = bucket_start(RollupRow.time_us.expression, bucket_us)
    good = func.sum(RollupRow.good)
    return (
        select(
            start,
            _mean_of_rows(good),
            func.min(RollupRow.low),
            func.max(RollupRow.high),
            good,
            case((good > 0, int(Quality.GOOD)), else_=func.min(RollupRow.quality)),
        )
        .where(*within)
        .group_by(start)
    )


def _mean_of_rows(good: ColumnElement[int]) -> ColumnElement[float | None]:
    """Mean of rows, each with its weight; large ones are scaled: their sum may be no number."""
    row, total = RollupRow, func.nullif(good, 0)
    is_large = func.abs(row.mean) > _LARGE
    plain = func.sum(case((is_large, 0.0), else_=row.mean * row.good)) / total
    scaled = func.sum(case((is_large, row.mean * _SCALE * row.good))) / total
    low, high = func.min(row.low) * _SCALE, func.max(row.high) * _SCALE
    # The last bit of a sum may lead beyond the largest number.
    within = case((scaled > high, high), (scaled < low, low), else_=scaled)
    return case((scaled.is_(None), plain), else_=plain + within / _SCALE)


def read(connection: Connection, query: BucketQuery) -> list[Bucket]:
    """Run one of the queries above."""
    return list(map(_bucket, connection.execute(query).all()))


def merged(parts: Iterable[Bucket]) -> list[Bucket]:
    """Join parts of the same bucket; ascending by time."""
    parts = list(parts)
    times_us = [part.time_us for part in parts]
    if all(map(lt, times_us, islice(times_us, 1, None))):
        return parts
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
