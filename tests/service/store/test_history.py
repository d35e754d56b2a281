import uuid

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.samples import Sample
from service.store import Rollup, Store

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
    store.write_samples(
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
    rollups = shared_store.read_rollup(asset, None, *span, bucket, 1000)

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
        assert rollup.count == good.size
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
        items = shared_store.read_rollup(asset, ["a", "b"], 0, 500, bucket, page, after)
        paged += items
        if len(items) < page:
            break
    assert paged == shared_store.read_rollup(asset, ["b", "a"], 0, 500, bucket, 1000)


def test_a_long_gap_costs_a_page_nothing(store: Store) -> None:
    year_us = 365 * 86_400_000_000
    store.write_samples([Sample("a", "x", year * year_us, 1.0, 192, 0) for year in (1, 40)])
    rollups = store.read_rollup("a", None, 0, 50 * year_us, 1_000_000, 10)
    assert [rollup.time_us for rollup in rollups] == [year_us, 40 * year_us]


def test_a_page_never_cuts_a_bucket(store: Store) -> None:
    store.write_samples([Sample("a", "x", time_us, 1.0, 192, 0) for time_us in (5, 21, 27, 33)])
    first = store.read_rollup("a", None, 0, 99, 10, 2)
    assert [(rollup.time_us, rollup.count) for rollup in first] == [(0, 1), (20, 2)]
    rest = store.read_rollup("a", None, 0, 99, 10, 2, (20, "x"))
    assert [(rollup.time_us, rollup.count) for rollup in rest] == [(30, 1)]


def test_a_bucket_without_length_is_refused(store: Store) -> None:
    with pytest.raises(ValueError, match="bucket_us = 0"):
        store.read_rollup("a", None, 0, 1, 0, 1)


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
    table = shared_store.minute_averages(asset, channels, start_us, end_us, offset_us)

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
