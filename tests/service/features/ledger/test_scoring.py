"""Kept forecasts are compared with what was measured: each reading once, in any order."""

import asyncio
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from patience import within
from prometheus_client import CollectorRegistry

from adapters.samples import Sample
from service.clock import ProcessClock
from service.features.ledger.part import ForecastLedger
from service.features.ledger.scoring import (
    DATA_WAIT_S,
    RETRY_S,
    SCORED_AFTER_S,
    ForecastScoring,
)
from service.features.ledger.tables import KeptForecasts
from service.store import Store, StoreUnavailableError
from service.store.forecast_records import IssuedContent, IssuedForecast, StoredForecast
from twin_core.verification import LEAD_TIMES_S

SECOND = 1_000_000
START_US = 1_763_700_017_000_000  # not on a full minute
RINGS = ("t_inner_ring_c", "t_outer_ring_c")
PLAN = [(3600.0, 1500.0, 2650.0, 23.0), (10_800.0, 3000.0, 2650.0, 23.0)]
HORIZON_S = 16_000
MARGIN_S = SCORED_AFTER_S + 2.0


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


def with_bands(forecast: Any, low_c: float, high_c: float) -> Any:
    """The same with a 95 % band between two temperatures, and one of the whole run 5 K wider."""
    edges = [round(100 * one) for one in (low_c, high_c, low_c - 5.0, high_c + 5.0)]
    content = msgspec.structs.replace(
        forecast.content, band_times_s=[0.0, 14_400.0], bands=[[edges] * 2] * 2
    )
    return msgspec.structs.replace(forecast, content=content)


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


def look(scoring: ForecastScoring, at_s: float) -> list[Any]:
    found = []
    more = True
    while more:
        more, score = scoring.look(START_US + round(at_s * SECOND))
        found += score
    return found


def states(store: Store, asset: str = "a") -> list[set[str]]:
    """What became of the readings of each forecast, by lead time."""
    return [
        set(itertools.chain(*zip(*one.outcome.states, strict=True)))
        for one in store.part(KeptForecasts).since(asset, 0)
    ]


def outcomes(store: Store, asset: str = "a") -> list[StoredForecast]:
    return store.part(KeptForecasts).since(asset, 0)


def test_a_plan_that_is_followed_is_scored_at_each_lead_time_when_it_has_come(
    store: Store,
) -> None:
    store.samples.write(machine())
    store.part(KeptForecasts).add([issued(600)])
    scoring = ForecastScoring(store, rate=1.0)
    scores = []
    for number, lead_s in enumerate(LEAD_TIMES_S):
        due_s = 600 + lead_s + MARGIN_S
        assert look(scoring, due_s - 1) == []
        scores += look(scoring, due_s)
        assert len(scores) == 2 * (number + 1)
    (one,) = outcomes(store)
    assert one.due_us is None
    assert states(store) == [{"scored"}]
    # Linear between the means of the minutes around each time.
    inner = [row[0] for row in one.outcome.measured_c]
    assert inner == pytest.approx([60.0 + (600 + s) / 2000.0 for s in LEAD_TIMES_S], abs=0.011)
    assert [(score.lead_time_s, score.inside) for score in scores] == [
        (lead_s, ring == 0) for lead_s in LEAD_TIMES_S for ring in (0, 1)
    ]
    assert look(scoring, 10 * HORIZON_S) == []


def test_once_the_plan_is_left_nothing_more_is_scored(store: Store) -> None:
    store.samples.write(machine(leaves_s=600 + 1900))
    store.part(KeptForecasts).add([issued(600), issued(5000)])
    look(ForecastScoring(store, rate=1.0), HORIZON_S + MARGIN_S)
    first, late = outcomes(store)
    by_lead = [row[0] for row in first.outcome.states]
    assert by_lead == ["scored"] * 3 + ["plan"] * 3
    assert {state for row in late.outcome.states for state in row if state != "waiting"} == {"plan"}


@pytest.mark.parametrize("inside", [True, False])
def test_a_plan_that_is_left_is_scored_where_it_was_followed_last(
    store: Store, inside: bool
) -> None:
    """60 + at/2000 degC: 61.2 when the machine stops, 31 min after the forecast."""
    store.samples.write(machine(leaves_s=600 + 1900))
    high_c = 62.0 if inside else 61.0
    store.part(KeptForecasts).add([with_bands(issued(600), 50.0, high_c), issued(600)])
    scores = look(ForecastScoring(store, rate=1.0), HORIZON_S + MARGIN_S)
    first, of_an_earlier_release = outcomes(store)
    assert [row[0] for row in first.outcome.states] == ["scored"] * 3 + ["plan"] * 3
    for number in range(3, 6):
        left = first.outcome.interrupted_at(number, 0)
        assert left is not None
        assert 1800.0 < left.after_s < 1900.0
        assert left.measured_c == pytest.approx(60.0 + (600 + left.after_s) / 2000.0, abs=0.02)
        assert left.is_inside is inside
        outer = first.outcome.interrupted_at(number, 1)
        assert outer is not None
        assert outer.is_inside is False, "71 degC all the time"
    assert [first.outcome.run_at(number, 0) for number in range(6)] == [True] * 6
    assert [first.outcome.run_at(number, 1) for number in range(6)] == [False] * 6
    assert all(first.outcome.interrupted_at(number, 0) is None for number in range(3))
    assert [row[0] for row in of_an_earlier_release.outcome.states] == ["scored"] * 3 + ["plan"] * 3
    assert of_an_earlier_release.outcome.interrupted_at(4, 0) is None
    lefts = [one.left_inside for one in scores if one.state == "plan"]
    assert sorted(map(str, lefts)) == sorted([str(inside)] * 3 + ["False"] * 3 + ["None"] * 6)


def test_a_sensor_that_is_lost_above_the_band_counts_as_outside(store: Store) -> None:
    lost = [one for one in machine() if one.channel != RINGS[0] or one.time_us < START_US + 10**9]
    store.samples.write(lost)
    store.part(KeptForecasts).add(
        [with_bands(issued(0, leads=[600, 3600]), 50.0, high_c) for high_c in (60.2, 65.0)]
    )
    look(ForecastScoring(store, rate=1.0), 3600 + DATA_WAIT_S + 1000.0)
    above, inside = outcomes(store)
    assert [row[0] for row in above.outcome.states] == ["scored", "data"]
    left = above.outcome.interrupted_at(1, 0)
    assert left is not None
    assert left.is_inside is False
    assert left.measured_c == pytest.approx(60.5, abs=0.03)
    assert inside.outcome.interrupted_at(1, 0) is None


def test_a_version_that_is_gone_is_not_scored(store: Store) -> None:
    store.samples.write(machine())
    store.part(KeptForecasts).add([issued(0, version=7), issued(0)])
    scores = look(ForecastScoring(store, rate=1.0), 300 + MARGIN_S)
    assert states(store) == [{"model"}, {"scored", "waiting"}]
    assert outcomes(store)[0].due_us is None
    assert sum(score.state == "model" for score in scores) == 2 * len(LEAD_TIMES_S)


@pytest.mark.parametrize("missing", [RINGS[:1], ("speed_rpm",), ("load_n",)])
def test_data_that_come_late_are_waited_for(store: Store, missing: tuple[str, ...]) -> None:
    """A gateway may bring them hours later; what never comes is set aside in the end."""
    store.samples.write(machine(end_s=1500, without=missing))
    store.part(KeptForecasts).add([issued(0, leads=[300, 600])])
    scoring = ForecastScoring(store, rate=1.0)
    look(scoring, 600 + MARGIN_S)
    ring = "scored" if missing == RINGS[:1] else "waiting"
    assert outcomes(store)[0].outcome.states == [["waiting", ring]] * 2
    store.samples.write([one for one in machine(end_s=500) if one.channel in missing])
    look(scoring, 600 + MARGIN_S + RETRY_S + 1)
    assert outcomes(store)[0].outcome.states[0] == ["scored", "scored"]
    # A speed that is known holds for five minutes, a temperature for none.
    last = "waiting" if missing == RINGS[:1] else "scored"
    assert outcomes(store)[0].outcome.states[1][0] == last
    for hours in range(1, 9):
        look(scoring, 600 + hours * 3600)
    assert outcomes(store)[0].due_us is None
    end = "data" if missing == RINGS[:1] else "scored"
    assert outcomes(store)[0].outcome.states[1][0] == end
    assert DATA_WAIT_S < 8 * 3600


@pytest.mark.parametrize("seed", range(6))
def test_restarts_and_irregular_looks_change_nothing(store: Store, seed: int) -> None:
    """At any times of the looks: each reading is settled once, and as one look at the end does."""
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
        store.part(KeptForecasts).add([issued(one, asset, leads=LEAD_TIMES_S[:5]) for one in made])
    until_s = end_s + 12_000 + DATA_WAIT_S
    at_s, scoring, scores = 0.0, ForecastScoring(store, rate=1.0), []
    while at_s < until_s:
        at_s += float(rng.exponential(900.0))
        if rng.random() < 0.2:
            scoring = ForecastScoring(store, rate=1.0)  # after a restart
        scores += look(scoring, at_s)
    look(ForecastScoring(store, rate=1.0), until_s + 1)
    found = {asset: [one.outcome for one in outcomes(store, asset)] for asset in ("a", "b")}
    assert found["a"] == found["b"]
    assert all(one.due_us is None for one in outcomes(store))
    assert len(scores) == 2 * 12 * 2 * 5
    # One look at the end, at new copies.
    reference = ForecastScoring(store, rate=1.0)
    store.part(KeptForecasts).add([issued(one, "b", leads=LEAD_TIMES_S[:5]) for one in made])
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
    offline, settle = True, store.part(KeptForecasts).settle

    def refusing(settled: Any) -> set[int]:
        if offline:
            raise StoreUnavailableError("offline")
        return settle(settled)

    monkeypatch.setattr(store.part(KeptForecasts), "settle", refusing)
    ledger = ForecastLedger(store, tmp_path, clock, registry)
    ledger.take(forecast)
    running = asyncio.create_task(ledger.run())

    def figure(**labels: str) -> float | None:
        return registry.get_sample_value("bearing_twin_forecast_readings_total", labels)

    async with within(60):
        while not outcomes(store):  # noqa: ASYNC110
            await asyncio.sleep(0.05)
        await asyncio.sleep(1.5)
        assert states(store) == [{"waiting"}]
        offline = False
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
