import tracemalloc
import uuid
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.samples import Sample
from service.store import Retention, Rollup, Store

SERIES = st.dictionaries(
    st.tuples(st.sampled_from(["a", "b"]), st.integers(0, 200)),
    st.tuples(
        st.floats(-1e6, 1e6, allow_subnormal=False), st.sampled_from([0, 24, 64, 88, 192, 216])
    ),
    max_size=60,
)
Series = dict[tuple[str, int], tuple[float, int]]


def fill(store: Store, series: Series, unit_us: int = 1) -> str:
    asset = uuid.uuid4().hex
    store.samples.write(
        [
            Sample(asset, channel, time * unit_us, value, quality, 0)
            for (channel, time), (value, quality) in series.items()
        ]
    )
    return asset


@given(series=SERIES, bucket=st.integers(1, 70), span=st.tuples(*[st.integers(0, 220)] * 2))
@settings(max_examples=60, deadline=None)
def test_rollups_are_those_of_numpy(
    shared_store: Store, series: Series, bucket: int, span: tuple[int, int]
) -> None:
    asset = fill(shared_store, series)
    rollups = shared_store.history.read(asset, None, *span, bucket, 1000)

    starts = {(time - time % bucket, channel) for channel, time in series}
    starts = {key for key in starts if span[0] <= key[0] < span[1]}
    assert [(r.time_us, r.channel) for r in rollups] == sorted(starts)
    for rollup in rollups:
        inside = [
            sample
            for (channel, time), sample in series.items()
            if channel == rollup.channel and time - time % bucket == rollup.time_us
        ]
        good = np.array([value for value, quality in inside if quality >= 192])
        assert rollup.good == good.size
        if good.size:
            assert rollup.mean == pytest.approx(good.mean(), rel=1e-9, abs=1e-9)
            assert (rollup.min, rollup.max, rollup.quality) == (good.min(), good.max(), 192)
        else:
            assert (rollup.mean, rollup.min, rollup.max) == (None, None, None)
            assert rollup.quality == min(quality for _, quality in inside)


@given(series=SERIES, bucket=st.integers(1, 70), page=st.integers(1, 7))
@settings(max_examples=40, deadline=None)
def test_rollups_page_by_page_are_all_of_them(
    shared_store: Store, series: Series, bucket: int, page: int
) -> None:
    asset = fill(shared_store, series)
    paged: list[Rollup] = []
    while True:
        after = (paged[-1].time_us, paged[-1].channel) if paged else None
        items = shared_store.history.read(asset, ["a", "b"], 0, 500, bucket, page, after)
        paged += items
        if len(items) < page:
            break
    assert paged == shared_store.history.read(asset, ["b", "a"], 0, 500, bucket, 1000)


def test_a_long_gap_costs_a_page_nothing(store: Store) -> None:
    year_us = 365 * 86_400_000_000
    store.samples.write([Sample("a", "x", year * year_us, 1.0, 192, 0) for year in (1, 40)])
    rollups = store.history.read("a", None, 0, 50 * year_us, 1_000_000, 10)
    assert [rollup.time_us for rollup in rollups] == [year_us, 40 * year_us]


def test_a_page_never_cuts_a_bucket(store: Store) -> None:
    store.samples.write([Sample("a", "x", time_us, 1.0, 192, 0) for time_us in (5, 21, 27, 33)])
    first = store.history.read("a", None, 0, 99, 10, 2)
    assert [(rollup.time_us, rollup.good) for rollup in first] == [(0, 1), (20, 2)]
    rest = store.history.read("a", None, 0, 99, 10, 2, (20, "x"))
    assert [(rollup.time_us, rollup.good) for rollup in rest] == [(30, 1)]


def test_a_bucket_without_length_is_refused(store: Store) -> None:
    with pytest.raises(ValueError, match="bucket_us = 0"):
        store.history.read("a", None, 0, 1, 0, 1)


@given(
    series=SERIES,
    span=st.tuples(*[st.integers(0, 220)] * 2),
    offset_us=st.sampled_from([0, -30_000_000]),
)
@settings(max_examples=60, deadline=None)
def test_minute_averages_are_those_of_numpy(
    shared_store: Store, series: Series, span: tuple[int, int], offset_us: int
) -> None:
    unit_us = 7_000_000  # up to nine samples in a minute
    asset = fill(shared_store, series, unit_us)
    channels = ["a", "b", "never stored"]
    start_us, end_us = (edge * unit_us for edge in span)
    table = shared_store.history.minute_averages(asset, channels, start_us, end_us, offset_us)

    rows = [
        (channel, (time * unit_us - offset_us) // 60_000_000 * 60_000_000 + offset_us, *sample)
        for (channel, time), sample in series.items()
        if span[0] <= time < span[1]
    ]
    assert table.minute_us.tolist() == sorted({minute for _, minute, _, _ in rows})
    assert set(table.mean) == set(table.good_count) == set(table.bad_count) == set(channels)
    for channel in channels:
        for index, at in enumerate(table.minute_us):
            inside = [(v, q) for name, minute, v, q in rows if name == channel and minute == at]
            good = np.array([value for value, quality in inside if quality >= 192])
            assert table.good_count[channel][index] == good.size
            assert table.bad_count[channel][index] == len(inside) - good.size
            mean = good.mean() if good.size else np.nan
            np.testing.assert_allclose(table.mean[channel][index], mean, rtol=1e-9, atol=1e-9)


HOUR_US = 3_600_000_000
LONG = st.dictionaries(
    st.tuples(st.sampled_from(["a", "b"]), st.integers(0, 6 * 3600 * 2)),  # half seconds
    st.tuples(
        st.floats(-1e6, 1e6, allow_subnormal=False), st.sampled_from([0, 24, 64, 192, 192, 216])
    ),
    max_size=80,
)


@given(
    parts=st.lists(LONG, min_size=1, max_size=3),
    refreshed=st.lists(st.integers(0, 7), min_size=3, max_size=3),
    bucket_s=st.sampled_from([60, 300, 1800, 3600, 7200]),
    page=st.integers(1, 50),
)
@settings(max_examples=60, deadline=None)
def test_rollups_are_right_whenever_they_were_computed(
    shared_store: Store, parts: list[Series], refreshed: list[int], bucket_s: int, page: int
) -> None:
    asset = uuid.uuid4().hex
    series: Series = {}
    for part, until in zip(parts, refreshed, strict=False):
        shared_store.samples.write(
            [
                Sample(asset, channel, half * 500_000, value, quality, 0)
                for (channel, half), (value, quality) in part.items()
            ]
        )
        for key, (value, quality) in part.items():
            if key not in series or (series[key][1] < 192 <= quality):
                series[key] = (value, quality)
        while shared_store.rollups.refresh(until * HOUR_US):
            pass
    rollups: list[Rollup] = []
    while True:
        after = (rollups[-1].time_us, rollups[-1].channel) if rollups else None
        bucket_us = bucket_s * 1_000_000
        items = shared_store.history.read(asset, None, 0, 7 * HOUR_US, bucket_us, page, after)
        rollups += items
        if len(items) < page:
            break
    expected: dict[tuple[int, str], list[tuple[float, int]]] = {}
    for (channel, half), one in series.items():
        expected.setdefault((half // 2 // bucket_s * bucket_us, channel), []).append(one)
    assert [(one.time_us, one.channel) for one in rollups] == sorted(expected)
    for rollup in rollups:
        inside = expected[rollup.time_us, rollup.channel]
        good = np.array([value for value, quality in inside if quality >= 192])
        assert rollup.good == good.size
        if good.size:
            assert rollup.mean == pytest.approx(good.mean(), rel=1e-9, abs=1e-6)
            assert (rollup.min, rollup.max, rollup.quality) == (good.min(), good.max(), 192)
        else:
            assert (rollup.mean, rollup.min, rollup.max) == (None, None, None)
            assert rollup.quality == min(quality for _, quality in inside)


def test_old_samples_are_condensed_before_they_go(store: Store) -> None:
    times_us = [k * 500_000 for k in range(0, 6 * 7200, 7)]
    store.samples.write(
        [Sample("a", "x", time_us, float(time_us % 97), 192, 0) for time_us in times_us]
    )
    day_us = 24 * HOUR_US

    def all_levels() -> list[list[Rollup]]:
        return [
            store.history.read("a", None, 0, 9 * HOUR_US, seconds * 1_000_000, 10**6)
            for seconds in (1, 60, 3600)
        ]

    before = all_levels()
    # Days are counted back from the newest sample.
    store.samples.write([Sample("b", "x", day_us + 2 * HOUR_US + 5, 1.0, 192, 0)])
    retention = Retention(raw_days=1.0)
    removed = store.rollups.expire(retention, day_us + 2 * HOUR_US + 5)
    assert removed == sum(time_us < 2 * HOUR_US for time_us in times_us)
    for level, now in zip(before, all_levels(), strict=True):
        assert [(r.time_us, r.good, r.min, r.max) for r in now] == [
            (r.time_us, r.good, r.min, r.max) for r in level
        ]
        assert [r.mean for r in now] == pytest.approx([r.mean for r in level])
    raw = store.samples.read("a", None, 0, 9 * HOUR_US, 10**6)
    assert raw[0].time_us >= 2 * HOUR_US

    # What is sent again, or comes this late, changes nothing that is condensed already.
    assert store.samples.write([Sample("a", "x", 500_000, 1e9, 192, 0)]) == (0, 0)
    while store.rollups.refresh(10 * HOUR_US):
        pass
    assert [len(level) for level in all_levels()] == [len(level) for level in before]
    assert store.rollups.expire(retention, day_us + 2 * HOUR_US + 5) == 0

    # Each level has its own end; minutes go by four hours.
    store.samples.write([Sample("b", "x", day_us + 5 * HOUR_US, 1.0, 192, 0)])
    assert store.rollups.expire(Retention(minute_days=1.0), day_us + 4 * HOUR_US - 1) == 0
    assert all_levels()[1][0].time_us == 0
    store.rollups.expire(Retention(minute_days=1.0), day_us + 5 * HOUR_US)
    seconds, minutes, hours = all_levels()
    assert seconds[0].time_us == hours[0].time_us == 0
    assert minutes[0].time_us == 4 * HOUR_US


def test_a_late_sample_before_its_hour_is_condensed_still_counts(store: Store) -> None:
    store.samples.write([Sample("a", "x", 5, 1.0, 192, 0)])
    store.rollups.refresh(HOUR_US)
    store.samples.write([Sample("a", "x", 6, 3.0, 192, 0)])
    store.samples.write([Sample("b", "x", 20 * HOUR_US, 3.0, 192, 0)])
    assert store.rollups.expire(Retention(raw_days=0.5), 20 * HOUR_US) == 2
    (hour,) = store.history.read("a", None, 0, HOUR_US, HOUR_US, 9)
    assert (hour.mean, hour.min, hour.max, hour.good) == (2.0, 1.0, 3.0, 2)


def test_the_memory_of_a_read_does_not_grow_with_the_number_of_channels(store: Store) -> None:
    rows = 4000
    for number in range(40):
        asset = "one" if number == 0 else "many"
        store.samples.write(
            [Sample(asset, f"c{number:02}", 1_000_000 * k, 1.0, 192, 0) for k in range(rows)]
        )

    def peak(read: Callable[[str], int], asset: str) -> int:
        tracemalloc.start()
        try:
            assert read(asset) == rows
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    def samples(asset: str) -> int:
        return len(store.samples.read(asset, None, 0, 10**10, rows))

    def rollups(asset: str) -> int:
        return len(store.history.read(asset, None, 0, 10**10, 1_000_000, rows))

    for read in (samples, rollups):
        read("one")  # what is made once
        assert peak(read, "many") < 4 * peak(read, "one")


def test_recent_minutes_of_many_assets_are_those_of_each(store: Store) -> None:
    rng = np.random.default_rng(0)
    names = [f"asset {number}" for number in range(30)]
    begin_us = 29_395_000 * 60_000_000
    samples = [
        Sample(name, channel, begin_us + int(at_us), float(value), quality, 0)
        for name in names
        for channel in ("speed_rpm", "t_inner_ring_c", "load_n")
        for at_us, value, quality in zip(
            rng.integers(0, 900_000_000, 60),
            rng.normal(50.0, 5.0, 60),
            rng.choice([192, 64, 16], 60, p=[0.8, 0.1, 0.1]).tolist(),
            strict=True,
        )
    ]
    store.samples.write(samples)
    wanted = {name: ["speed_rpm", "t_inner_ring_c", "never"] for name in [*names, "nobody"]}
    end_us = begin_us + 600_000_000
    found = store.history.recent_minute_means(wanted, begin_us, end_us)
    assert found.keys() == {(name, one) for name, of_name in wanted.items() for one in of_name}
    assert found["nobody", "speed_rpm"] == found["asset 3", "never"] == {}
    for name in names:
        for channel in ("speed_rpm", "t_inner_ring_c"):
            table = store.history.minute_averages(name, [channel], begin_us, end_us)
            means = dict(zip(table.minute_us.tolist(), table.mean[channel].tolist(), strict=True))
            known = {at_us: mean for at_us, mean in means.items() if mean == mean}
            assert found[name, channel] == pytest.approx(known)
