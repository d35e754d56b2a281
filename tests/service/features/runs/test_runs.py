"""Runs are found in what is stored, whenever it comes; names and annotations stay."""

import random
from dataclasses import replace

import pytest

from adapters.samples import Sample
from service.clock import HOUR_US, MINUTE_US
from service.features.runs.runs import Annotation, Run, Runs
from service.store import AuditEntry, Store

START_US = 1_795_420_800_000_000
DAY_US = 24 * HOUR_US


def speed(minutes: range, rpm: float, asset: str = "a") -> list[Sample]:
    return [
        Sample(asset, "speed_rpm", START_US + minute * MINUTE_US + second * 1_000_000, rpm, 192, 0)
        for minute in minutes
        for second in (0, 20, 40)
    ]


def runs(store: Store, asset: str = "a", now_us: int = START_US + 10 * HOUR_US) -> list[Run]:
    store.part(Runs).refresh(asset, now_us)
    return list(store.part(Runs).page(asset, 100).items)[::-1]


def test_the_same_runs_in_whatever_order_their_data_come(store: Store) -> None:
    """Two runs, of which one goes over the hour; asked for in between, named in between."""
    samples = [
        *speed(range(30), 0.0), *speed(range(30, 95), 1500.0), *speed(range(95, 130), 2.0),
        *speed(range(130, 133), 900.0), *speed(range(133, 200), 0.0),
    ]  # fmt: skip
    store.samples.write([one._replace(asset="whole") for one in samples])
    expected = runs(store, "whole")
    assert [(one.start_us - START_US, one.end_us) for one in expected] == [
        (30 * MINUTE_US, START_US + 95 * MINUTE_US),
        (130 * MINUTE_US, START_US + 133 * MINUTE_US),
    ]
    shuffler = random.Random(4)
    shuffler.shuffle(samples)
    for first in range(0, len(samples), 150):
        store.samples.write(samples[first : first + 150])
        runs(store)
    found = runs(store)
    spans = [(one.start_us, one.end_us, one.ended) for one in expected]
    assert [(one.start_us, one.end_us, one.ended) for one in found] == spans
    assert runs(store) == found


@pytest.mark.parametrize("seed", range(4))
def test_what_is_remembered_changes_nothing(sqlite_store: Store, seed: int) -> None:
    """Data of three days in any order, condensed now and then; against a look at the whole."""
    store, chance = sqlite_store, random.Random(seed)
    minutes, rpm = 3 * 24 * 60, 0.0
    samples = []
    for minute in range(minutes):
        if chance.random() < 0.01:
            rpm = chance.choice([0.0, 0.0, 1200.0, 10.0])
        if chance.random() < 0.95:
            time_us = START_US + minute * MINUTE_US
            samples.append(Sample("a", "speed_rpm", time_us, rpm, 192, 0))
    parts = [samples[first : first + 300] for first in range(0, len(samples), 300)]
    late = [parts.pop(chance.randrange(len(parts))) for _ in range(3)]
    for part in [*parts, *late]:
        store.samples.write(part)
        now_us = START_US + DAY_US * 4 if part in late else part[-1].time_us + MINUTE_US
        store.part(Runs).refresh("a", now_us)
        if chance.random() < 0.7:
            store.rollups.refresh(now_us)
            store.part(Runs).refresh("a", now_us)
    found = runs(store, now_us=START_US + DAY_US * 4)
    store.samples.write([one._replace(asset="b") for one in samples])
    expected = runs(store, "b", START_US + DAY_US * 4)
    assert len(expected) > 3
    spans = [(one.start_us, one.end_us, one.ended) for one in expected]
    assert [(one.start_us, one.end_us, one.ended) for one in found] == spans


def test_a_name_stays_when_late_data_join_or_extend_a_run(store: Store) -> None:
    store.samples.write([*speed(range(60), 1000.0), *speed(range(100, 160), 1000.0)])
    first, second = runs(store)
    assert (first.ended, second.ended) == ("no data", "no data")
    line = AuditEntry(1, "operator x", "", "run.name")
    assert store.part(Runs).rename("a", first.id, "cold start", "operator x", line)
    assert store.part(Runs).rename("a", second.id, "after lunch", "operator y")
    assert not store.part(Runs).rename("a", "nothing", "x", "operator x", line)
    assert len(store.audit.page().items) == 1
    store.samples.write(speed(range(60, 100), 1000.0))
    (joined,) = runs(store)
    assert (joined.id, joined.name) == (first.id, "cold start + after lunch")
    assert joined.end_us == second.end_us
    store.samples.write(speed(range(160, 190), 0.0))
    assert runs(store)[0].ended == "standstill"


def test_a_run_that_goes_on_ends_with_its_standstill(store: Store) -> None:
    store.samples.write([*speed(range(10), 0.0), *speed(range(10, 40), 800.0)])
    (going,) = runs(store, now_us=START_US + 40 * MINUTE_US)
    assert (going.end_us, going.ended, going.covers(START_US + DAY_US)) == (None, "", True)
    store.samples.write(speed(range(40, 50), 0.0))
    (over,) = runs(store, now_us=START_US + 50 * MINUTE_US)
    assert over == replace(going, end_us=START_US + 40 * MINUTE_US, ended="standstill")


def test_pages_go_back_in_time(store: Store) -> None:
    for number in range(5):
        begin = number * 30
        store.samples.write(speed(range(begin, begin + 10), 500.0))
        store.samples.write(speed(range(begin + 10, begin + 30), 0.0))
    everything = runs(store)
    assert len(everything) == 5
    page = store.part(Runs).page("a", 2)
    rest = store.part(Runs).page("a", 10, page.next_cursor)
    assert [*page.items, *rest.items] == everything[::-1]
    assert rest.next_cursor is None
    assert store.part(Runs).get("a", everything[2].id) == everything[2]


def test_annotations_belong_to_a_time(store: Store) -> None:
    line = AuditEntry(1, "operator x", "", "annotation.add")
    for number, at_us in enumerate((5, 2, 9)):
        store.part(Runs).annotate(Annotation(f"n{number}", "a", at_us, "oil", "operator x"), line)
    store.part(Runs).annotate(Annotation("other", "b", 5, "oil", "operator x"))
    assert [one.time_us for one in store.part(Runs).annotations("a", 2, 5)] == [2, 5]
    assert not store.part(Runs).remove_annotation("a", "other", line)
    assert store.part(Runs).remove_annotation("a", "n0", line)
    assert [one.id for one in store.part(Runs).annotations("a", 0, 10)] == ["n1", "n2"]
    assert len(store.audit.page().items) == 4


@pytest.mark.parametrize("bad", [0, 5])
def test_bad_values_tell_nothing(sqlite_store: Store, bad: int) -> None:
    samples = [one._replace(quality=bad) for one in speed(range(60), 1000.0)]
    sqlite_store.samples.write(samples)
    assert runs(sqlite_store) == []
