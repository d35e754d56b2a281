"""The forecast ledger over HTTP: what is kept, how good it was, and what-ifs that are kept."""

from typing import Any

import pytest

from service.clock import rfc3339
from service.features.ledger.documents import ForecastPerformance, KeptForecastList
from service.features.ledger.tables import KeptForecasts, Settled
from service.store.forecast_records import (
    Interrupted,
    IssuedContent,
    IssuedForecast,
    Outcome,
)

A = "/api/v1/assets/bench-1"
SECOND = 1_000_000
RINGS = ["t_inner_ring_c", "t_outer_ring_c"]
LABEL = "load law from prior only"


def issued(world: Any, back_s: int, version: int = 1, labels: tuple[str, ...] = ()) -> Any:
    content = IssuedContent(
        steps=[(7200.0, 1500.0, 2650.0, 23.0)],
        planned=True,
        labels=list(labels),
        channels=RINGS,
        lead_times_s=[300, 3600],
        high_risk=[False, True],
        quantiles=[[[5800, 5900, 6000, 6100, 6200]] * 2] * 2,
        naive={"persistence": [[5000, 5000]] * 2, "arx": [[6300, None]] * 2},
    )
    time_us = world.bench.time_us - back_s * SECOND
    return IssuedForecast("bench-1", time_us, version, "period", content)


def settle(world: Any, *outcomes: Outcome) -> None:
    stored = world.store.part(KeptForecasts).since("bench-1", 0)
    for one, outcome in zip(stored, outcomes, strict=False):
        world.store.part(KeptForecasts).settle([Settled(one.id, one.due_us, None, outcome)])


SCORED = Outcome([["scored", "scored"], ["scored", "data"]], [[60.5, 63.0], [57.0, None]])
LEFT = Outcome([["scored", "scored"], ["plan", "plan"]], [[61.5, 60.0], [None, None]])


@pytest.fixture
def filled(world: Any) -> Any:
    labels = ("initial state of t_node_7_c known to ±7 K only", LABEL)
    world.store.part(KeptForecasts).add(
        [issued(world, 9000), issued(world, 8000), issued(world, 60, 2, labels)]
    )
    settle(world, SCORED, LEFT)
    return world


async def performance(world: Any, **query: Any) -> ForecastPerformance:
    answer = await world.client("viewer").get(f"{A}/forecast-performance", params=query)
    assert answer.status_code == 200, answer.text
    return ForecastPerformance.model_validate_json(answer.content)


async def test_scores_of_each_channel_lead_time_risk_label_and_version(filled: Any) -> None:
    found = await performance(filled)
    assert found.forecasts == 3
    assert found.start == rfc3339(filled.bench.time_us - 9000 * SECOND)
    by = {(one.channel, one.lead_time_s, one.model_version): one for one in found.items}
    assert len(by) == len(found.items) == 8
    inner = by["t_inner_ring_c", 300, 1]
    assert (inner.n, inner.set_aside, inner.waiting) == (2, 0, 0)
    assert (inner.risk, inner.label) == ("low", None)
    # 60.5 and 61.5 against 58, 59, 60, 61 and 62.
    assert (inner.coverage_50, inner.coverage_95) == (0.5, 1.0)
    assert (inner.bias_k, inner.mae_k, inner.interval_score_k) == (-1.0, 1.0, 4.0)
    assert dict(inner.below) == {"q025": 0.0, "q25": 0.0, "q50": 0.0, "q75": 0.5, "q975": 1.0}
    naive = {kind: (one.mae_k, one.crps_k) for kind, one in inner.naive.items()}
    assert naive == {"persistence": (11.0, 11.0), "linear": (None, None), "arx": (2.0, 2.0)}
    outer = by["t_outer_ring_c", 3600, 1]
    assert (outer.n, outer.set_aside, dict(outer.set_aside_by)) == (
        0,
        2,
        {"plan": 1, "data": 1, "model": 0},
    )
    assert (outer.risk, outer.coverage_95, outer.mae_k) == ("high", None, None)
    waiting = by["t_inner_ring_c", 3600, 2]
    assert (waiting.n, waiting.waiting) == (0, 1)
    assert waiting.label == f"initial state not well known; {LABEL}"


async def test_what_was_interrupted_counts_and_whole_runs_and_independent_ones(world: Any) -> None:
    """Three forecasts of an hour, two of which overlap; two were left, one of them outside."""
    world.store.part(KeptForecasts).add([issued(world, back_s) for back_s in (9000, 8000, 4000)])
    inside, outside = (Interrupted(630.0, value, 58.0, 62.0) for value in (61.0, 64.5))
    outcomes = [
        Outcome([["scored"] * 2, ["plan"] * 2], [[60.0] * 2, [None] * 2],
                [[None] * 2, [left, None]], [[True] * 2, [run, None]])
        for left, run in ((inside, True), (outside, False))
    ]  # fmt: skip
    settle(world, *outcomes, Outcome([["scored"] * 2] * 2, [[60.0] * 2] * 2, [], [[True] * 2] * 2))
    found = {(one.channel, one.lead_time_s): one for one in (await performance(world)).items}
    inner = found["t_inner_ring_c", 3600]
    assert (inner.n, inner.coverage_95, inner.set_aside) == (1, 1.0, 2)
    assert (inner.left, inner.left_inside_95) == (2, 1)
    assert (inner.whole_runs, inner.whole_runs_inside, inner.independent_runs) == (3, 2, 2)
    outer = found["t_outer_ring_c", 3600]
    assert (outer.left, outer.whole_runs, outer.independent_runs) == (0, 1, 1)
    soon = found["t_inner_ring_c", 300]
    assert (soon.left, soon.whole_runs, soon.independent_runs) == (0, 3, 3)
    listed = await world.client("viewer").get(f"{A}/forecasts")
    page = KeptForecastList.model_validate_json(listed.content)
    reading = page.items[1].points[1].readings[0]
    assert reading.state == "plan"
    assert reading.left is not None
    assert dict(reading.left) == {
        "after_s": 630.0, "measured_c": 64.5, "q025": 58.0, "q975": 62.0, "inside": False,
    }  # fmt: skip
    assert (reading.run_inside, page.items[0].points[1].readings[0].left) == (False, None)


async def test_what_is_asked_for_is_answered_and_nothing_else(filled: Any) -> None:
    def kinds(found: ForecastPerformance) -> set[Any]:
        return {(one.lead_time_s, one.risk, one.model_version) for one in found.items}

    assert kinds(await performance(filled, lead_time_s=300)) == {(300, "low", 1), (300, "low", 2)}
    assert kinds(await performance(filled, risk="high", version=1)) == {(3600, "high", 1)}
    assert kinds(await performance(filled, lead_time_s=77)) == set()
    since = rfc3339(filled.bench.time_us - 100 * SECOND)
    assert (await performance(filled, start=since)).forecasts == 1
    empty = await filled.client("viewer").get("/api/v1/assets/rig-2/forecast-performance")
    assert empty.json() == {"start": None, "forecasts": 0, "items": []}


@pytest.mark.parametrize(
    "query", ["lead_time_s=0", "risk=some", "version=0", "start=yesterday", "lead_time_s=x"]
)
async def test_a_wrong_question_is_refused(world: Any, query: str) -> None:
    answer = await world.client("viewer").get(f"{A}/forecast-performance?{query}")
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["parameter"] == query.split("=", maxsplit=1)[0]


async def test_kept_forecasts_are_listed_in_pages_the_last_first(filled: Any) -> None:
    client = filled.client("viewer")
    items, query = [], {"limit": 2}
    while True:
        answer = await client.get(f"{A}/forecasts", params=query)
        page = KeptForecastList.model_validate_json(answer.content)
        items += page.items
        if page.next is None:
            break
        query = {"limit": 2, "cursor": page.next}
        assert 'rel="next"' in answer.headers["link"]
    assert [one.model_version for one in items] == [2, 1, 1]
    (first, later), last = items[2].points, items[2]
    assert (last.reason, last.planned, last.labels) == ("period", True, [])
    assert dict(last.profile[0])["speed_rpm"] == 1500.0
    reading = first.readings[0]
    assert (reading.q025, reading.q50, reading.measured_c, reading.state) == (
        58.0,
        60.0,
        60.5,
        "scored",
    )
    assert reading.naive == {"persistence": 50.0, "linear": None, "arx": 63.0}
    assert (later.risk, later.readings[1].state, later.readings[1].measured_c) == (
        "high",
        "data",
        None,
    )
    wrong = await client.get(f"{A}/forecasts", params={"cursor": "nonsense"})
    assert wrong.status_code == 422


PROFILE = [{"duration_s": 600, "speed_rpm": 1500, "load_n": 2650}]


async def test_a_what_if_is_kept_only_where_that_is_asked_for(world: Any) -> None:
    client = world.client("operator")
    answer = (await client.post(f"{A}/forecasts", json={"profile": PROFILE})).json()
    assert answer["kept_at"] is None
    assert world.store.part(KeptForecasts).since("bench-1", 0) == []
    body = {"profile": PROFILE, "keep": True, "nodes": ["t_node_7_c"]}
    answer = (await client.post(f"{A}/forecasts", json=body)).json()
    assert answer["kept_at"] == rfc3339(world.bench.time_us)
    assert list(answer["nodes"]) == ["t_node_7_c"]
    (kept,) = world.store.part(KeptForecasts).since("bench-1", 0)
    assert (kept.issued.reason, kept.issued.content.channels) == ("asked", RINGS)
    audit = (await world.client("admin").get("/api/v1/audit")).json()["items"]
    lines = [line for line in audit if line["who"] != "service"]
    assert [(line["action"], line["target"]) for line in lines] == [
        ("forecast.keep", "asset bench-1")
    ]


async def test_what_cannot_be_kept_is_refused_with_the_reason(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = world.client("operator")

    async def refused(status: int, profile: Any = PROFILE) -> str:
        body = {"profile": profile, "keep": True}
        answer = await client.post(f"{A}/forecasts", json=body)
        assert answer.status_code == status, answer.text
        problem = answer.json()
        return str((problem["errors"] or [problem])[0]["detail"])

    short = [{"duration_s": 299, "speed_rpm": 1500, "load_n": 2650}]
    assert "299 s, expected at least 300 s" in await refused(422, short)
    monkeypatch.setattr(world.bench, "blind", ["speed_rpm"])
    assert "missing: speed_rpm" in await refused(503)
    monkeypatch.setattr(world.bench, "blind", [])
    asked = issued(world, 0)
    asked = IssuedForecast(asked.asset, asked.time_us, 1, "asked", asked.content)
    world.store.part(KeptForecasts).add([asked] * 200)
    assert "200 kept what-ifs" in await refused(422)
    assert len(world.store.part(KeptForecasts).since("bench-1", 0)) == 200
