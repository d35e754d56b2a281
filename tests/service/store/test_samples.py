import math
import uuid

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.samples import Sample, is_good
from service.store import Store, StoredSample, WriteCounts

NAN = float("nan")
QUALITIES = st.sampled_from([0, 16, 24, 64, 68, 192, 216])
VALUES = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False), st.sampled_from([NAN, math.inf, -math.inf])
)


def sample(time_us: int, value: float = 1.0, quality: int = 192, channel: str = "x") -> Sample:
    return Sample("bench-1", channel, time_us, value, quality, time_us)


def stored(store: Store, asset: str = "bench-1") -> list[StoredSample]:
    return store.samples.read(asset, None, 0, 2**62, 10_000)


def test_samples_come_back_in_order_of_time_then_channel(store: Store) -> None:
    counts = store.samples.write(
        [sample(20, 2.5, channel="b"), sample(10), sample(20, 3.5, channel="a")]
    )
    assert counts == WriteCounts(3, 0)
    assert stored(store) == [
        ("x", 10, 1.0, 192, 10),
        ("a", 20, 3.5, 192, 20),
        ("b", 20, 2.5, 192, 20),
    ]
    assert store.samples.channels("bench-1") == ["a", "b", "x"]
    assert store.samples.channels("bench-2") == []


def test_nothing_to_write_is_no_error(store: Store) -> None:
    assert store.samples.write([]) == (0, 0)


@pytest.mark.parametrize(
    ("first", "second", "kept", "counts"),
    [
        ((1.0, 192), (2.0, 192), (1.0, 192), (0, 1)),  # the first good value wins
        ((1.0, 192), (NAN, 24), (1.0, 192), (0, 1)),
        ((NAN, 24), (2.0, 192), (2.0, 192), (1, 0)),  # a good one replaces a bad one
        ((5.0, 64), (2.0, 216), (2.0, 216), (1, 0)),  # or an uncertain one
        ((NAN, 24), (5.0, 64), (None, 24), (0, 1)),  # an uncertain one does not
        ((NAN, 24), (NAN, 0), (None, 24), (0, 1)),
    ],
)
@pytest.mark.parametrize("together", [True, False])
def test_a_time_is_stored_once(
    store: Store,
    first: tuple[float, int],
    second: tuple[float, int],
    kept: tuple[float | None, int],
    counts: tuple[int, int],
    together: bool,
) -> None:
    both = [sample(7, *first)._replace(received_us=8), sample(7, *second)._replace(received_us=9)]
    if together:
        assert store.samples.write(both) == (1 + counts[0], counts[1])
    else:
        assert store.samples.write(both[:1]) == (1, 0)
        assert store.samples.write(both[1:]) == counts
    # What replaces another comes with its own received time.
    assert stored(store) == [("x", 7, *kept, 8 + counts[0])]


@given(
    batches=st.lists(
        st.lists(
            st.builds(
                Sample,
                asset=st.just(""),
                channel=st.sampled_from(["a", "b", "c"]),
                time_us=st.integers(0, 8),
                value=VALUES,
                quality=QUALITIES,
                received_us=st.integers(0, 2**62),
            ),
            max_size=12,
        ),
        max_size=5,
    ),
    page=st.integers(1, 5),
)
@settings(max_examples=60, deadline=None)
def test_any_batches_give_what_the_rule_says_page_by_page(
    shared_store: Store, batches: list[list[Sample]], page: int
) -> None:
    asset = uuid.uuid4().hex
    expected: dict[tuple[int, str], tuple[float | None, int, int]] = {}
    changes = 0
    total = WriteCounts(0, 0)
    for batch in batches:
        for one in batch:
            finite = math.isfinite(one.value)
            value = one.value if finite else None
            quality = one.quality if finite or not is_good(one.quality) else 0
            old = expected.get((one.time_us, one.channel))
            if old is None or (not is_good(old[1]) and is_good(quality)):
                expected[one.time_us, one.channel] = (value, quality, one.received_us)
                changes += 1
        counts = shared_store.samples.write([one._replace(asset=asset) for one in batch])
        total = WriteCounts(*(a + b for a, b in zip(total, counts, strict=True)))
    assert total == (changes, sum(map(len, batches)) - changes)

    paged: list[StoredSample] = []
    while True:
        after = (paged[-1].time_us, paged[-1].channel) if paged else None
        items = shared_store.samples.read(asset, None, 0, 100, page, after)
        paged += items
        if len(items) < page:
            break
    assert {(one.time_us, one.channel): (one[2:]) for one in paged} == expected
    assert [(one.time_us, one.channel) for one in paged] == sorted(expected)


def test_a_batch_of_many_statements_follows_the_same_rule(store: Store) -> None:
    bad = [sample(t, NAN, 24) for t in range(2500)]
    good = [sample(t, float(t)) for t in range(100, 2400)]
    again = [sample(t, -1.0) for t in range(50, 2600)]
    # Bad and then good in one batch are two changes, good over good is a duplicate.
    expected = (2500 + 2300 + (2600 - 50 - 2300), 2300)
    assert store.samples.write([*bad, *good, *again]) == expected
    found = stored(store)
    assert [one.time_us for one in found] == list(range(2600))
    assert [one.value for one in found[:50]] == [None] * 50
    assert [one.value for one in found[50:]] == [
        float(t) if 100 <= t < 2400 else -1.0 for t in range(50, 2600)
    ]


def test_a_span_has_its_start_and_not_its_end(store: Store) -> None:
    store.samples.write([sample(time_us) for time_us in (10, 20, 30)])
    assert [s.time_us for s in store.samples.read("bench-1", ["x"], 10, 30, 9)] == [10, 20]
    assert store.samples.read("bench-1", ["x"], 31, 99, 9) == []
    assert store.samples.read("bench-1", ["no such"], 0, 99, 9) == []
    assert store.samples.read("nobody", None, 0, 99, 9) == []


def test_assets_do_not_see_each_other(store: Store) -> None:
    store.samples.write([sample(1), sample(1, 9.0)._replace(asset="bench-2")])
    assert stored(store) == [("x", 1, 1.0, 192, 1)]
    assert stored(store, "bench-2") == [("x", 1, 9.0, 192, 1)]


@pytest.mark.parametrize(
    "wrong",
    [
        sample(-1),
        sample(2**63),
        sample(1, quality=256),
        sample(1, quality=-1),
        sample(1)._replace(received_us=-1),
        sample(1)._replace(received_us=2**63),
    ],
)
def test_a_sample_that_cannot_be_is_refused_with_its_batch(store: Store, wrong: Sample) -> None:
    with pytest.raises(ValueError, match="expected times after 1970 and a quality byte"):
        store.samples.write([sample(5), wrong])
    assert stored(store) == []
    store.samples.write([sample(5)])
    assert len(stored(store)) == 1


def test_latest_and_first_and_what_is_open(store: Store) -> None:
    assert store.samples.latest("bench-1") == {}
    assert store.samples.first_time_us("bench-1") is None
    assert store.samples.open_ends() == {}
    store.samples.write(
        [
            sample(30, 3.0),
            sample(10, 1.0),
            sample(20, 5.0, channel="y"),
            sample(25, NAN, 24, channel="y"),
            sample(40, 7.0, 64, channel="z"),
        ]
    )
    assert store.samples.latest("bench-1") == {
        "x": ("x", 30, 3.0, 192, 30),
        "y": ("y", 25, None, 24, 25),
        "z": ("z", 40, 7.0, 64, 40),
    }
    assert store.samples.first_time_us("bench-1") == 10
    assert store.samples.open_ends() == {("bench-1", "x"): 30, ("bench-1", "z"): 40}


def test_of_minus_zero_sqlite_keeps_zero(store: Store) -> None:
    """As docs/run/store.md says; it is no other number."""
    store.samples.write([Sample("a", "x", 1, -0.0, 192, 1)])
    (found,) = store.samples.read("a", None, 0, 2**62, 10)
    assert found.value == 0.0
    is_sqlite = store._database.engine.dialect.name == "sqlite"
    assert math.copysign(1.0, found.value) == (1.0 if is_sqlite else -1.0)
