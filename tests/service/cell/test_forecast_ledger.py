"""Kept forecasts are held against what was measured: each reading once, whatever happens."""

import asyncio
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from prometheus_client import CollectorRegistry

from adapters.samples import Sample
from service.cell.ledger import ForecastLedger
from service.cell.settling import LOOKS_AGAIN_S, SETTLING_S, WAITS_FOR_DATA_S, Settling
from service.clock import ProcessClock
from service.store import Store, StoreUnavailableError
from service.store.forecast_records import IssuedContent, IssuedForecast, StoredForecast
from twin_core.verification import LEAD_TIMES_S

SECOND = 1_000_000
START_US = 1_763_700_017_000_000  # not on a full minute
RINGS = ("t_inner_ring_c", "t_outer_ring_c")
PLAN = [(3600.0, 1500.0, 2650.0, 23.0), (10_800.0, 3000.0, 2650.0, 23.0)]
HORIZON_S = 16_000
MARGIN_S = SETTLING_S + 2.0


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with Store.open("", tmp_path) as store:
        for asset in ("a", "b"):
            version = store.models.add(asset, "candidate", "", {}, 0)
            store.models.activate(asset, version, "test", "", 0)
        yield store


def issued(made_s: int, asset: str = "a", version: int = 1, leads: Any = LEAD_TIMES_S) -> Any:
    """A forecast made some seconds after the start, of a machine that runs the plan."""
    elapsed_s, steps = float(made_s), []
    for duration_s, *level in PLAN:
        left_s = duration_s - elapsed_s
        elapsed_s = max(-left_s, 0.0)
        if left_s > 0:
            steps.append((left_s, *level))
    content = IssuedContent(
        steps=steps,  # type: ignore[arg-type]
        planned=True,
        labels=[],
        channels=list(RINGS),
        lead_times_s=list(leads),
        high_risk=[False] * len(leads),
        quantiles=[[[5000, 5500, 6000, 6500, 7000]] * 2] * len(leads),
        naive={"persistence": [[6000, 6000]] * len(leads)},
    )
    return IssuedForecast(asset, START_US + made_s * SECOND, version, "period", content)


def machine(
    asset: str = "a",
    begin_s: int = 0,
    end_s: int = HORIZON_S,
    step_s: int = 20,
    without: tuple[str, ...] = (),
    leaves_s: float = float("inf"),
) -> list[Sample]:
    """Samples of a machine that runs the plan, and leaves it for a standstill."""
    samples = []
    for at_s in range(begin_s, end_s, step_s):
        running = at_s < leaves_s
        speed_rpm = (1500.0 if at_s < 3600 else 3000.0) if running else 0.0
        values = {
            "speed_rpm": speed_rpm,
            "load_n": 2650.0,
            RINGS[0]: 60.0 + at_s / 2000.0,
            RINGS[1]: 71.0,
        }
        samples += [
            Sample(asset, name, START_US + at_s * SECOND, value, 192, 0)
            for name, value in values.items()
            if name not in without
        ]
    return samples


def look(settling: Settling, at_s: float) -> list[Any]:
    found = []
    more = True
    while more:
        more, news = settling.look(START_US + round(at_s * SECOND))
        found += news
    return found


def states(store: Store, asset: str = "a") -> list[set[str]]:
    """What became of the readings of each forecast, by lead time."""
    return [
        set(itertools.chain(*zip(*one.outcome.states, strict=True)))
        for one in store.forecasts.since(asset, 0)
    ]


def outcomes(store: Store, asset: str = "a") -> list[StoredForecast]:
    return store.forecasts.since(asset, 0)


def test_a_plan_that_is_followed_is_scored_at_each_lead_time_when_it_has_come(
    store: Store,
) -> None:
    store.samples.write(machine())
    store.forecasts.add([issued(600)])
    settling = Settling(store, rate=1.0)
    told = []
    for number, lead_s in enumerate(LEAD_TIMES_S):
        due_s = 600 + lead_s + MARGIN_S
        assert look(settling, due_s - 1) == []
        told += look(settling, due_s)
        assert len(told) == 2 * (number + 1)
    (one,) = outcomes(store)
    assert one.due_us is None
    assert states(store) == [{"scored"}]
    # Linear between the means of the minutes around each time.
    inner = [row[0] for row in one.outcome.measured_c]
    assert inner == pytest.approx([60.0 + (600 + s) / 2000.0 for s in LEAD_TIMES_S], abs=0.011)
    assert [(news.lead_time_s, news.inside) for news in told] == [
        (lead_s, ring == 0) for lead_s in LEAD_TIMES_S for ring in (0, 1)
    ]
    assert look(settling, 10 * HORIZON_S) == []


def test_once_the_plan_is_left_nothing_more_is_scored(store: Store) -> None:
    store.samples.write(machine(leaves_s=600 + 1900))
    store.forecasts.add([issued(600), issued(5000)])
    look(Settling(store, rate=1.0), HORIZON_S + MARGIN_S)
    first, late = outcomes(store)
    by_lead = [row[0] for row in first.outcome.states]
    assert by_lead == ["scored"] * 3 + ["plan"] * 3
    assert {state for row in late.outcome.states for state in row if state != "waiting"} == {"plan"}


def test_a_version_that_is_gone_is_not_scored(store: Store) -> None:
    store.samples.write(machine())
    store.forecasts.add([issued(0, version=7), issued(0)])
    told = look(Settling(store, rate=1.0), 300 + MARGIN_S)
    assert states(store) == [{"model"}, {"scored", "waiting"}]
    assert outcomes(store)[0].due_us is None
    assert sum(news.state == "model" for news in told) == 2 * len(LEAD_TIMES_S)


@pytest.mark.parametrize("missing", [RINGS[:1], ("speed_rpm",), ("load_n",)])
def test_data_that_come_late_are_waited_for(store: Store, missing: tuple[str, ...]) -> None:
    """A gateway may bring them hours later; what never comes is set aside in the end."""
    store.samples.write(machine(end_s=1500, without=missing))
    store.forecasts.add([issued(0, leads=[300, 600])])
    settling = Settling(store, rate=1.0)
    look(settling, 600 + MARGIN_S)
    ring = "scored" if missing == RINGS[:1] else "waiting"
    assert outcomes(store)[0].outcome.states == [["waiting", ring]] * 2
    store.samples.write([one for one in machine(end_s=500) if one.channel in missing])
    look(settling, 600 + MARGIN_S + LOOKS_AGAIN_S + 1)
    assert outcomes(store)[0].outcome.states[0] == ["scored", "scored"]
    # A speed that is known holds for five minutes, a temperature for none.
    last = "waiting" if missing == RINGS[:1] else "scored"
    assert outcomes(store)[0].outcome.states[1][0] == last
    for hours in range(1, 9):
        look(settling, 600 + hours * 3600)
    assert outcomes(store)[0].due_us is None
    end = "data" if missing == RINGS[:1] else "scored"
    assert outcomes(store)[0].outcome.states[1][0] == end
    assert WAITS_FOR_DATA_S < 8 * 3600


@pytest.mark.parametrize("seed", range(6))
def test_restarts_and_irregular_looks_change_nothing(store: Store, seed: int) -> None:
    """Whoever looks, and when: each reading is settled once, and as one look at the end does."""
    rng = np.random.default_rng(seed)
    leaves_s = float(rng.uniform(2000, HORIZON_S))
    gap_s = int(rng.integers(0, 12_000))
    end_s = 9000
    samples = machine(end_s=end_s, step_s=30, leaves_s=leaves_s)
    hole = (START_US + gap_s * SECOND, START_US + (gap_s + 1500) * SECOND)
    samples = [one for one in samples if not hole[0] <= one.time_us < hole[1]]
    made = sorted(rng.integers(0, end_s - 2000, 12).tolist())
    for asset in ("a", "b"):
        store.samples.write([Sample(asset, *one[1:]) for one in samples])
        store.forecasts.add([issued(one, asset, leads=LEAD_TIMES_S[:5]) for one in made])
    until_s = end_s + 12_000 + WAITS_FOR_DATA_S
    at_s, settling, told = 0.0, Settling(store, rate=1.0), []
    while at_s < until_s:
        at_s += float(rng.exponential(900.0))
        if rng.random() < 0.2:
            settling = Settling(store, rate=1.0)  # after a restart
        told += look(settling, at_s)
    look(Settling(store, rate=1.0), until_s + 1)
    found = {asset: [one.outcome for one in outcomes(store, asset)] for asset in ("a", "b")}
    assert found["a"] == found["b"]
    assert all(one.due_us is None for one in outcomes(store))
    assert len(told) == 2 * 12 * 2 * 5
    # One look at the end, at a store that begins anew.
    reference = Settling(store, rate=1.0)
    store.forecasts.add([issued(one, "b", leads=LEAD_TIMES_S[:5]) for one in made])
    look(reference, until_s + 1)
    again = [one.outcome for one in outcomes(store, "b")][12:]
    assert again == found["a"]


async def test_a_store_that_is_away_loses_nothing(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, registry = ProcessClock(3600.0), CollectorRegistry()
    now_us = clock.now_us()
    forecast = issued(0, leads=[300])
    forecast = IssuedForecast("a", now_us - 3600 * SECOND, 1, "period", forecast.content)
    shift_us = forecast.time_us - START_US
    store.samples.write(
        [one._replace(time_us=one.time_us + shift_us) for one in machine(end_s=900)]
    )
    away, settle = True, store.forecasts.settle

    def refusing(settled: Any) -> set[int]:
        if away:
            raise StoreUnavailableError("away")
        return settle(settled)

    monkeypatch.setattr(store.forecasts, "settle", refusing)
    ledger = ForecastLedger(store, tmp_path, clock, registry)
    ledger.take(forecast)
    running = asyncio.create_task(ledger.run())

    def figure(**labels: str) -> float | None:
        return registry.get_sample_value("bearing_twin_forecast_readings_total", labels)

    async with asyncio.timeout(60):
        while not outcomes(store):  # noqa: ASYNC110
            await asyncio.sleep(0.05)
        await asyncio.sleep(1.5)
        assert states(store) == [{"waiting"}]
        away = False
        while outcomes(store)[0].due_us is not None:  # noqa: ASYNC110
            await asyncio.sleep(0.05)
        inside = {"lead_time_s": "300", "risk": "low", "outcome": "inside"}
        while figure(**inside) is None:  # noqa: ASYNC110
            await asyncio.sleep(0.05)
    running.cancel()
    await asyncio.wait({running})
    assert states(store) == [{"scored"}]
    assert figure(**inside) == 1.0
    assert figure(**{**inside, "outcome": "outside"}) == 1.0
