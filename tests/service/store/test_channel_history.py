"""What a historian reads of one channel, against plain numpy: packed or not, condensed or not."""

import uuid
from bisect import bisect_right

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.samples import Sample
from service.clock import HOUR_US, MINUTE_US
from service.store import Retention, Store

START_US = 1_790_000_000_000_000 // HOUR_US * HOUR_US
SECOND_US = 1_000_000
#: Seconds after the start: within a minute, over the ends of minutes and hours, hours apart.
SECONDS = st.one_of(
    st.integers(0, 90), st.integers(3500, 3700), st.sampled_from([7199, 7200, 10_000, 21_600])
)
SERIES = st.dictionaries(
    st.builds(lambda s, us: START_US + s * SECOND_US + us, SECONDS, st.sampled_from([0, 250_000])),
    st.tuples(st.floats(-1e6, 1e6).map(float), st.sampled_from([0, 24, 64, 192, 216])),
    max_size=40,
)
#: How much of it is in blocks and rollups: nothing, the first hour, everything.
DONE = st.sampled_from([0, START_US + HOUR_US, START_US + 10 * HOUR_US])
MOMENTS = st.builds(lambda s, us: START_US + s * SECOND_US + us, SECONDS, st.integers(0, 999_999))
Series = dict[int, tuple[float, int]]


def fill(store: Store, series: Series, done_us: int) -> str:
    asset = uuid.uuid4().hex
    store.samples.write([Sample(asset, "t", time_us, *pair, 0) for time_us, pair in series.items()])
    while done_us and store.rollups.refresh(done_us):
        pass
    while done_us and store.packing.pack(done_us):
        pass
    return asset


@given(series=SERIES, done=DONE, span=st.tuples(MOMENTS, MOMENTS), limit=st.integers(1, 50))
@settings(max_examples=30, deadline=None)
def test_first_and_last_samples_of_a_span(
    shared_store: Store, series: Series, done: int, span: tuple[int, int], limit: int
) -> None:
    asset = fill(shared_store, series, done)
    inside = [(t, *series[t]) for t in sorted(series) if span[0] <= t < span[1]]
    history = shared_store.channel_history
    for read, expected in (
        (history.samples, inside[:limit]),
        (history.last_samples, inside[-limit:]),
    ):
        found = read(asset, "t", *span, limit)
        columns = (found.times_us, found.values, found.qualities)
        assert list(zip(*(one.tolist() for one in columns), strict=True)) == expected


@given(series=SERIES, done=DONE, moments=st.lists(MOMENTS, max_size=12))
@settings(max_examples=30, deadline=None)
def test_a_value_holds_until_the_next_and_for_an_hour(
    shared_store: Store, series: Series, done: int, moments: list[int]
) -> None:
    asset = fill(shared_store, series, done)
    found = shared_store.channel_history.at_times(asset, "t", moments)
    times_us = sorted(series)
    for moment_us, time_us, value, quality in zip(moments, *found[:3], strict=True):
        at = bisect_right(times_us, moment_us) - 1
        if at < 0 or moment_us - times_us[at] > HOUR_US:
            assert (time_us, quality) == (-1, 0)
        else:
            assert (time_us, value, quality) == (times_us[at], *series[times_us[at]])


@given(
    series=SERIES,
    done=DONE,
    begin=st.one_of(MOMENTS, st.just(START_US), st.just(START_US + 120 * SECOND_US)),
    interval=st.one_of(
        st.sampled_from([1, 250_000, SECOND_US, 7 * SECOND_US, 61 * SECOND_US]),
        st.sampled_from([MINUTE_US, 5 * MINUTE_US, HOUR_US, HOUR_US + 1, 2 * HOUR_US]),
        st.just(7 * HOUR_US + 61 * SECOND_US),
    ),
    count=st.integers(1, 40),
)
@settings(max_examples=60, deadline=None)
def test_statistics_of_intervals_from_any_moment(
    shared_store: Store, series: Series, done: int, begin: int, interval: int, count: int
) -> None:
    asset = fill(shared_store, series, done)
    buckets = shared_store.channel_history.intervals(asset, "t", begin, interval, count)
    found = {one.time_us: one for one in buckets}
    assert [one.time_us for one in buckets] == sorted(found)
    for number in range(count):
        start_us = begin + number * interval
        inside = [pair for t, pair in series.items() if start_us <= t < start_us + interval]
        bucket = found.pop(start_us, None)
        if not inside:
            assert bucket is None
            continue
        assert bucket is not None
        good = np.array([value for value, quality in inside if quality >= 192])
        assert bucket.good == good.size
        if good.size:
            assert bucket.mean == pytest.approx(good.mean(), rel=1e-9, abs=1e-9)
            assert (bucket.low, bucket.high, bucket.quality) == (good.min(), good.max(), 192)
        else:
            assert (bucket.mean, bucket.quality) == (None, min(pair[1] for pair in inside))
    assert found == {}


def test_raw_samples_that_are_gone_are_left_as_statistics_per_second(sqlite_store: Store) -> None:
    series = {START_US + number * SECOND_US: (float(number), 192) for number in range(2 * 3600)}
    series[START_US + 13 * HOUR_US] = (0.0, 192)
    asset = fill(sqlite_store, series, START_US + 10 * HOUR_US)
    keep = Retention(raw_days=0.5, second_days=30.0)
    assert sqlite_store.rollups.expire(keep, START_US + 13 * HOUR_US) == 3600
    begin_us = START_US + 3590 * SECOND_US
    found = sqlite_store.channel_history.intervals(asset, "t", begin_us, 20 * SECOND_US, 1)
    assert [(one.low, one.high, one.good) for one in found] == [(3590.0, 3609.0, 20)]
    assert sqlite_store.channel_history.samples(asset, "t", 0, START_US + 10, 9).times_us.size == 0


def test_a_channel_that_was_never_stored_has_nothing(sqlite_store: Store) -> None:
    history = sqlite_store.channel_history
    assert history.samples("none", "t", 0, START_US, 10).times_us.size == 0
    assert history.last_samples("none", "t", 0, START_US, 10).times_us.size == 0
    assert history.at_times("none", "t", [START_US]).times_us.tolist() == [-1]
    assert history.intervals("none", "t", 0, HOUR_US, 10) == []
