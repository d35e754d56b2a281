"""The record of an asset: of the lead time and risk that an alarm is about, from the store."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from patience import within
from prometheus_client import CollectorRegistry

from service.features.ledger.part import ForecastLedger
from service.features.ledger.record import Record, nearest_leads_s, records_of
from service.features.ledger.tables import KeptForecasts, Settled
from service.live.profiles import StepAhead
from service.store import Store
from service.store.forecast_records import Interrupted, IssuedContent, IssuedForecast, Outcome
from tests.service.features.ledger.test_keeping import WARM, issue

RING = "t_inner_ring_c"
MINUTE_US = 60_000_000


def keep(store: Store, asset: str, first_us: int, count: int, high_risk: bool) -> None:
    """Forecasts an hour ahead, every 30 min; the first was left outside, the others inside."""
    content = IssuedContent(
        [(7200.0, 1500.0, 2650.0, 23.0)], True, [], [RING], [3600], [high_risk],
        [[[5800, 5900, 6000, 6100, 6200]]], {},
    )  # fmt: skip
    kept = store.part(KeptForecasts)
    kept.add(
        [
            IssuedForecast(asset, first_us + 30 * k * MINUTE_US, 1, "period", content)
            for k in range(count)
        ]
    )
    left = Outcome([["plan"]], [[None]], [[Interrupted(630.0, 64.0, 58.0, 62.0)]], [[False]])
    inside = Outcome([["scored"]], [[60.0]], [], [[True]])
    waiting = [one for one in kept.since(asset, 0) if one.due_us is not None]
    for number, one in enumerate(waiting):
        outcome = left if number == 0 else inside
        kept.settle([Settled(one.id, one.due_us or 0, None, outcome)])


@pytest.fixture
def store(tmp_path: Path) -> Any:
    with Store.open("", tmp_path) as store:
        yield store


def test_it_counts_by_lead_time_and_risk_with_the_interrupted_ones(store: Store) -> None:
    keep(store, "a", 0, 32, high_risk=True)
    keep(store, "a", 32 * 30 * MINUTE_US, 4, high_risk=False)
    found = records_of(store.part(KeptForecasts).since("a", 0))
    assert found == {(RING, 3600, "high"): Record(31, 32, 16), (RING, 3600, "low"): Record(3, 4, 2)}
    assert found[RING, 3600, "high"].text(3600, "high") == (
        "record 1 h ahead, high risk: 31 of 32 inside (16 independent runs)"
    )
    assert Record(1, 1, 1).text(300, "low") == (
        "record 5 min ahead, low risk: 1 of 1 inside (1 independent run)"
    )


@pytest.mark.parametrize(
    ("lead_s", "nearest_s"), [(0.0, 300), (400.0, 300), (3000.0, 3600), (9e9, 14_400), (None, 3600)]
)
def test_the_lead_time_is_the_nearest(lead_s: float | None, nearest_s: int) -> None:
    assert nearest_leads_s(lead_s)[0] == nearest_s


async def test_the_alarms_of_a_live_twin_get_it(
    make_live: Callable[..., Any], tmp_path: Path
) -> None:
    """Read from the store by the ledger's part, of the risk that the plan has up to then."""
    live = make_live()
    with Store.open("", tmp_path / "of-the-ledger") as store:
        now_us = live.clock.now_us()
        keep(store, live.runtime.id, now_us - 40 * 3600 * 1_000_000, 32, high_risk=True)
        ledger = ForecastLedger(store, tmp_path, live.clock, CollectorRegistry())
        ledger.settle(live.runtime)
        running = asyncio.create_task(ledger.run())
        (follower,) = live.runtime._forecasts.followers
        async with within(30):
            while follower.read_us is None:  # noqa: ASYNC110
                await asyncio.sleep(0.02)
        running.cancel()
        await asyncio.wait({running})
        assert follower.record(RING, 4000.0) == "", "of low risk there is none"
        heavy = [StepAhead(14_400.0, 6200.0, 5500.0, 23.0)]
        with pytest.raises(AttributeError):
            follower.issued(issue(0.0, steps=heavy))  # without a result nothing is kept
        said = live.runtime._forecasts.record(RING, 4000.0)
        assert said == "record 1 h ahead, high risk: 31 of 32 inside (16 independent runs)"
        assert follower.is_asked
    assert WARM
