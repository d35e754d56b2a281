"""An asset at a glance is never better than its verdict, and says what it needs."""

import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from adapters.samples import Sample
from service.alarms import AlarmBook
from service.clock import ProcessClock, rfc3339
from service.documents.fleet import FleetAsset
from service.documents.verdicts import VerdictDocument
from service.domain.alarm_condition import AlarmCondition
from service.live.asset_summary import asset_summary
from service.live.readings import Readings
from service.live.verdict import Evidence, judge
from service.store import Alarm, Outbox, Store
from service.web import overview
from tests.service.live.test_verdict import (
    HOUR_US,
    INPUTS,
    NOW_US,
    RING,
    WAYS,
    channel,
    outlook,
    put,
)

from .conftest import asset_section

KNOWN = {"version": 2, "trusted": True, "identified": True, "drifted": False}


def seen(evidence: Evidence, alarms: tuple[Alarm, ...] = (), **model: Any) -> FleetAsset:
    verdict = VerdictDocument(**dict(judge(evidence)), time=rfc3339(NOW_US))
    return asset_summary(evidence.settings, evidence.readings, verdict, alarms, **(KNOWN | model))


@pytest.fixture
def make_evidence() -> Callable[..., Evidence]:
    def make(**changes: Any) -> Evidence:
        readings = Readings("bench-1", dict.fromkeys(INPUTS, 10.0), NOW_US - HOUR_US)
        calm = outlook(channel(), channel())
        given = {"twin_runs": True, "identified": True, "outlook": calm} | changes
        return Evidence(asset_section(), readings, NOW_US, **given)

    return make


def test_no_state_is_better_than_the_verdict(make_evidence: Callable[..., Evidence]) -> None:
    """Whatever is missing, in whatever way, and however hot it is."""
    chance = random.Random(11)
    states = set()
    # The next step of a node, which no time to a limit tells of.
    node_ahead = replace(outlook(channel(), channel(0.4)), crossings={})
    in_hand = replace(outlook(channel(0.4), channel()), crossings={})
    for _ in range(500):
        evidence = make_evidence(
            twin_runs=chance.random() < 0.8,
            identified=chance.random() < 0.8,
            outlook=chance.choice([None, outlook(channel(), channel(0.4)), node_ahead, in_hand]),
        )
        for name in INPUTS:
            hot = name == RING and chance.random() < 0.4
            way = chance.choice(WAYS) if chance.random() < 0.3 else "good"
            put(evidence.readings, name, way, 96.0 if hot else None)
        asset = seen(evidence, identified=evidence.identified)
        verdict = judge(evidence)
        states.add(asset.state)
        assert (asset.now, asset.next_step) == (verdict.now.word, verdict.next_step.word)
        if asset.state in ("safe", "ahead"):
            assert asset.now == "safe"
        if asset.state == "safe":
            assert "not safe" not in (asset.next_step, verdict.present_step.word)
        if overview._mark(asset) == "h":
            assert (asset.now, asset.next_step) == ("safe", "safe")
        if verdict.now.limit is not None:
            assert (asset.state, asset.value_c) == ("over", 96.0)
        if asset.state == "lost":
            assert set(asset.missing) & set(INPUTS)
        if asset.state not in ("safe", "waiting"):
            assert asset.attention is not None
            assert asset.reason
    assert states == {"over", "ahead", "lost", "unknown", "safe"}


def test_what_has_never_spoken_waits_and_needs_no_attention(
    make_evidence: Callable[..., Evidence],
) -> None:
    evidence = make_evidence()
    asset = seen(evidence, identified=False)
    assert (asset.state, asset.attention, asset.value_c) == ("waiting", None, None)
    # One word of any channel: what it lacks is lost.
    sample = Sample("bench-1", RING, NOW_US - HOUR_US, 30.0, 192, NOW_US - HOUR_US)
    evidence.readings.add([sample])
    asset = seen(evidence)
    assert (asset.state, asset.attention, asset.value_c) == ("lost", "lost", 30.0)
    assert asset.value_at == rfc3339(NOW_US - HOUR_US)


def test_a_model_in_doubt_needs_attention_only_behind_everything_else(
    make_evidence: Callable[..., Evidence],
) -> None:
    evidence = make_evidence()
    for name in INPUTS:
        put(evidence.readings, name, "good")
    assert seen(evidence).attention is None
    assert seen(evidence, drifted=True).attention == "drifted"
    assert seen(evidence, drifted=True, identified=False).attention == "not identified"
    assert seen(evidence, identified=False, trusted=False).attention == "not trusted"
    ahead = make_evidence(outlook=outlook(channel(), channel(0.4)))
    for name in INPUTS:
        put(ahead.readings, name, "good")
    asset = seen(ahead, trusted=False)
    assert (asset.state, asset.attention, asset.seconds_to_limit) == ("ahead", "ahead", 900.0)


def test_an_alarm_that_waits_comes_first_and_one_that_stands_stays_over(
    make_evidence: Callable[..., Evidence], tmp_path: Path
) -> None:
    """Though its data are lost."""
    evidence = make_evidence()
    put(evidence.readings, RING, "stale", 96.0)
    with Store.open("", tmp_path) as store, Outbox.open(tmp_path, store) as outbox:
        book = AlarmBook(outbox, ProcessClock(), lambda alarm: None)
        for priority, level in ((2, "warning"), (1, "alarm")):
            condition = AlarmCondition(
                asset="bench-1", kind="measured limit", channel=RING, level=level, active=True,
                value=96.0, limit_value=95.0, message=f"over {level}", priority=priority,
            )  # fmt: skip
            book.evaluate(condition)
        asset = seen(evidence, tuple(book.active()))
        assert (asset.state, asset.attention, asset.unacknowledged) == ("over", "alarm", 2)
        assert asset.alarm is not None
        assert (asset.alarm.priority, asset.reason) == (1, "over alarm")
        assert overview._mark(asset) == "A"
        for alarm in book.active():
            book.acknowledge(alarm.id, "somebody")
        asset = seen(evidence, tuple(book.active()))
        assert (asset.state, asset.attention, asset.alarm) == ("over", "over", None)
