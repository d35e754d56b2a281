"""The forecast ledger in both kinds of store: nothing twice, nothing lost, nothing held up."""

from pathlib import Path

import msgspec
import pytest
from sqlalchemy import update

from service.features.ledger.documents import forecast_performance
from service.features.ledger.tables import ForecastBatch, KeptForecastRow, KeptForecasts, Settled
from service.store import AuditEntry, Outbox, Store
from service.store.deliveries import Delivery
from service.store.forecast_records import (
    IssuedContent,
    IssuedForecast,
    Outcome,
    degrees,
    hundredths,
)

SECOND = 1_000_000
LEADS = [300, 600]


def issued(asset: str = "a", time_us: int = 0, version: int = 1) -> IssuedForecast:
    content = IssuedContent(
        steps=[(3600.0, 1500.0, 2650.0, 23.0)],
        planned=True,
        labels=["load law from prior only"],
        channels=["t_inner_ring_c", "t_outer_ring_c"],
        lead_times_s=LEADS,
        high_risk=[False, True],
        quantiles=[[[4000, 4100, 4200, 4300, None]] * 2] * 2,
        naive={"persistence": [[4000, None]] * 2},
    )
    return IssuedForecast(asset, time_us, version, "step", content)


def test_what_was_forecast_comes_back_as_it_was(store: Store) -> None:
    given = [issued("a", 5 * SECOND), issued("b", 7 * SECOND), issued("a", 9 * SECOND)]
    store.part(KeptForecasts).add(given)
    assert [one.issued for one in store.part(KeptForecasts).since("a", 0)] == [given[0], given[2]]
    assert [one.issued for one in store.part(KeptForecasts).since("a", 6 * SECOND)] == [given[2]]
    assert store.part(KeptForecasts).since("a", 0, version=2) == []
    assert store.part(KeptForecasts).since("b", 0)[0].outcome == Outcome.waiting(given[1].content)
    page = store.part(KeptForecasts).page("a", 1)
    assert [one.issued.time_us for one in page.items] == [9 * SECOND]
    page = store.part(KeptForecasts).page("a", 1, page.next_cursor)
    assert ([one.issued.time_us for one in page.items], page.next_cursor) == ([5 * SECOND], None)
    assert store.part(KeptForecasts).count_waiting("a", "step") == 2
    assert store.part(KeptForecasts).count_waiting("a", "asked") == 0


def test_a_delivery_that_comes_again_is_kept_once(store: Store) -> None:
    for _ in range(2):
        store.part(KeptForecasts).add([issued()], Delivery("sender", 1))
    store.part(KeptForecasts).add([issued()], Delivery("sender", 2))
    assert len(store.part(KeptForecasts).since("a", 0)) == 2


def test_a_reading_is_settled_once_whoever_looks_at_it(store: Store) -> None:
    store.models.activate("a", store.models.add("a", "candidate", "", {}, 0), "test", "", 0)
    store.part(KeptForecasts).add([issued("a"), issued("b", 1)])
    assert store.part(KeptForecasts).due(299 * SECOND, 10) == []
    first, other = store.part(KeptForecasts).due(301 * SECOND, 10)
    assert (first.issued.asset, first.has_model, other.has_model) == ("a", True, False)
    assert len(store.part(KeptForecasts).due(301 * SECOND, 1)) == 1
    came = Outcome([["scored", "data"], ["waiting"] * 2], [[42.5, None], [None] * 2])
    settled = Settled(first.id, 300 * SECOND, 600 * SECOND, came)
    assert store.part(KeptForecasts).settle([settled]) == {first.id}
    another = Outcome([["plan"] * 2] * 2, [[None] * 2] * 2)
    # Another look that had found it due at the same time comes too late.
    assert (
        store.part(KeptForecasts).settle([Settled(first.id, 300 * SECOND, None, another)]) == set()
    )
    assert store.part(KeptForecasts).since("a", 0)[0].outcome == came
    assert [one.id for one in store.part(KeptForecasts).due(599 * SECOND, 10)] == [other.id]
    assert store.part(KeptForecasts).settle([Settled(first.id, 600 * SECOND, None, another)]) == {
        first.id
    }
    assert store.part(KeptForecasts).count_waiting("a", "step") == 0


def test_one_that_cannot_be_read_holds_up_no_other(store: Store) -> None:
    store.part(KeptForecasts).add([issued("a"), issued("b", 1)])
    with store._database.writing() as connection:
        connection.execute(
            update(KeptForecastRow).where(KeptForecastRow.asset == "a").values(issued=b"\xc1")
        )
    assert [one.issued.asset for one in store.part(KeptForecasts).due(10**12, 10)] == ["b"]
    assert [one.issued.asset for one in store.part(KeptForecasts).due(10**12, 1)] == ["b"]
    assert store.part(KeptForecasts).since("a", 0) == []


def test_old_ones_leave(store: Store) -> None:
    store.part(KeptForecasts).add([issued("a", second * SECOND) for second in range(1500)])
    assert store.part(KeptForecasts).expire(1200 * SECOND) == 1200
    assert store.part(KeptForecasts).since("a", 0)[0].issued.time_us == 1200 * SECOND


def test_a_batch_goes_through_the_outbox_unchanged(store: Store, tmp_path: Path) -> None:
    given = (issued("a"), issued("b", 3))
    with Outbox.open(tmp_path, store) as outbox:
        outbox.record(ForecastBatch(given))
        line = AuditEntry(1, "operator bt_1", "10.0.0.9", "forecast.keep", "asset a")
        outbox.record(ForecastBatch((issued("c"),), line))
        assert outbox.flush(30.0)
    assert store.audit.page().items == [line]
    assert len(store.part(KeptForecasts).since("c", 0)) == 1
    kept = [store.part(KeptForecasts).since(asset, 0)[0].issued for asset in "ab"]
    assert kept == list(given)


@pytest.mark.parametrize("value", [None, float("nan"), float("inf"), 1e9])
def test_what_is_no_temperature_is_kept_as_none(value: float | None) -> None:
    assert hundredths(value) is None
    assert degrees(hundredths(-12.344)) == -12.34


def test_rows_of_an_earlier_release_are_read_on(store: Store) -> None:
    """They have neither bands nor interrupted readings: arrays that end where they ended then."""
    store.part(KeptForecasts).add([issued("a"), issued("a", 1)])
    before = msgspec.msgpack.decode(msgspec.msgpack.encode(issued("a").content))[:8]
    came = [[["scored", "plan"], ["plan", "data"]], [[42.0, None], [None, None]]]
    with store._database.writing() as connection:
        connection.execute(update(KeptForecastRow).values(issued=msgspec.msgpack.encode(before)))
        connection.execute(
            update(KeptForecastRow)
            .where(KeptForecastRow.time_us == 1)
            .values(outcome=msgspec.msgpack.encode(came))
        )
    waiting, settled = store.part(KeptForecasts).since("a", 0)
    assert waiting.issued.content == issued("a").content
    assert waiting.outcome == Outcome.waiting(issued("a").content)
    assert settled.outcome == Outcome(*came)
    assert settled.outcome.interrupted_at(0, 1) is None
    assert settled.outcome.run_at(0, 0) is None
    (item,) = [
        one
        for one in forecast_performance([waiting, settled]).items
        if (one.channel, one.lead_time_s) == ("t_inner_ring_c", 300)
    ]
    assert (item.set_aside, item.left, item.whole_runs, item.waiting) == (0, 0, 0, 1)
