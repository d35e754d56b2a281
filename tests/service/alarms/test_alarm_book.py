import json
import sqlite3
import uuid
from dataclasses import replace

import pytest
from alarm_bench import COLD, HOT, SECOND_US, START_US, UNKNOWN, Bench
from hypothesis import given, settings
from hypothesis import strategies as st

from service.alarms import (
    AlarmCondition,
    AlarmEvent,
    AlarmState,
    NotAllowedError,
    UnknownAlarmError,
    next_state,
)
from service.clock import rfc3339
from service.documents.alarms import Peak, alarm_document, alarm_summary, transition_document
from service.store.opening import FILE_NAME


def test_a_whole_life_is_journaled_with_who_when_and_why(bench: Bench) -> None:
    assert bench.after(0, COLD) == "NORM"
    assert bench.after(1, HOT) == "UNACK"
    first = bench.only()
    bench.clock.advance(5)
    acked = bench.book.acknowledge(first.id, "eva", "cooling on")
    assert (acked.state, acked.acknowledged_by) == ("ACKED", "eva")
    assert bench.after(5, COLD) == "NORM"
    assert [alarm.state for alarm in bench.told] == ["UNACK", "ACKED", "NORM"]
    assert {alarm.id for alarm in bench.told} == {first.id}
    told = bench.told[-1]
    assert told.raised_at_us == START_US + 1 * SECOND_US
    assert told.acknowledged_at_us == START_US + 6 * SECOND_US
    assert told.returned_at_us == told.since_us == START_US + 11 * SECOND_US
    assert [
        (line.time_us - START_US, line.from_state, line.to_state, line.who, line.comment)
        for line in bench.journal()
    ] == [
        (1 * SECOND_US, "NORM", "UNACK", "service", ""),
        (6 * SECOND_US, "UNACK", "ACKED", "eva", "cooling on"),
        (11 * SECOND_US, "ACKED", "NORM", "service", ""),
    ]
    assert bench.store.alarms.load() == []
    assert bench.after(1, HOT) == "UNACK"
    assert bench.only().id != first.id  # a new life


def test_returned_unacknowledged_waits_and_may_be_raised_again(bench: Bench) -> None:
    bench.after(0, HOT)
    assert bench.after(1, COLD) == "RTNUN"
    returned = bench.only()
    assert returned.returned_at_us == bench.clock.us
    assert bench.after(1, HOT) == "UNACK"
    again = bench.only()
    assert (again.id, again.raised_at_us) == (returned.id, returned.raised_at_us)
    assert (again.since_us, again.returned_at_us) == (bench.clock.us, None)
    bench.after(1, COLD)
    over = bench.book.acknowledge(returned.id, "eva")
    assert (over.state, over.acknowledged_by) == ("NORM", "eva")
    assert bench.book.active() == []


def test_acknowledging_twice_is_refused_and_names_who_was_first(bench: Bench) -> None:
    bench.after(0, HOT)
    alarm = bench.only()
    bench.book.acknowledge(alarm.id, "first")
    with pytest.raises(NotAllowedError, match=r"is ACKED \(acknowledged by first\)"):
        bench.book.acknowledge(alarm.id, "second")
    assert bench.only().acknowledged_by == "first"
    assert len(bench.journal()) == 2


def test_an_alarm_that_is_over_cannot_be_acknowledged(bench: Bench) -> None:
    bench.after(0, HOT)
    alarm = bench.only()
    bench.book.acknowledge(alarm.id, "eva")
    bench.after(1, COLD)
    for unknown in (alarm.id, "no such"):
        with pytest.raises(UnknownAlarmError, match="no open alarm"):
            bench.book.acknowledge(unknown, "eva")


def test_on_delay_counts_process_time(bench: Bench) -> None:
    slow = replace(HOT, on_delay_s=60.0)
    assert bench.after(0, slow) == "NORM"
    assert bench.after(59.9, slow) == "NORM"
    assert bench.after(0.1, slow) == "UNACK"
    assert bench.only().raised_at_us == START_US + 60 * SECOND_US


def test_off_delay_counts_process_time(bench: Bench) -> None:
    bench.after(0, HOT)
    slow = replace(COLD, off_delay_s=30.0)
    assert bench.after(10, slow) == "UNACK"
    assert bench.after(29.9, slow) == "UNACK"
    assert bench.after(0.1, slow) == "RTNUN"


def test_chatter_raises_nothing_and_does_not_clear_either(bench: Bench) -> None:
    on = replace(HOT, on_delay_s=10.0, off_delay_s=10.0)
    off = replace(COLD, on_delay_s=10.0, off_delay_s=10.0)
    for _ in range(50):
        assert bench.after(6, on) == "NORM"
        assert bench.after(6, off) == "NORM"
    bench.after(1, on)
    assert bench.after(10, on) == "UNACK"
    for _ in range(50):
        assert bench.after(6, off) == "UNACK"
        assert bench.after(6, on) == "UNACK"
    assert len(bench.journal()) == 1
    assert len(bench.told) == 1


def test_a_bad_sample_neither_raises_nor_clears(bench: Bench) -> None:
    assert bench.after(0, UNKNOWN) == "NORM"
    assert bench.after(10_000, UNKNOWN) == "NORM"
    bench.after(1, HOT)
    assert bench.after(10_000, UNKNOWN) == "UNACK"
    bench.after(1, COLD)
    assert bench.after(10_000, UNKNOWN) == "RTNUN"
    assert len(bench.journal()) == 2


def test_delays_stand_still_while_the_condition_cannot_be_told(bench: Bench) -> None:
    slow = replace(HOT, on_delay_s=60.0)
    bench.after(0, slow)
    bench.after(40, slow)
    bench.after(1, UNKNOWN)
    bench.after(10_000, UNKNOWN)
    assert bench.after(1, slow) == "NORM"  # 40 s are known, the time without data is not
    assert bench.after(19, slow) == "NORM"
    assert bench.after(1, slow) == "UNACK"


def test_a_clock_that_steps_back_raises_nothing_early(bench: Bench) -> None:
    slow = replace(HOT, on_delay_s=60.0)
    bench.after(0, slow)
    assert bench.after(-3600, slow) == "NORM"
    assert bench.after(30, slow) == "NORM"
    assert bench.after(30, slow) == "UNACK"


def test_the_deadband_holds_an_alarm_but_raises_none(bench: Bench) -> None:
    near = replace(COLD, value=104.5, deadband=1.0)
    assert bench.after(0, near) == "NORM"
    bench.after(1, HOT)
    assert bench.after(1, near) == "UNACK"
    assert bench.after(1, replace(near, value=105.0)) == "UNACK"
    assert bench.after(1, replace(near, value=104.0)) == "RTNUN"
    assert bench.after(1, near) == "RTNUN"


def test_conditions_are_told_apart_by_asset_kind_channel_and_level(bench: Bench) -> None:
    others: list[AlarmCondition] = [
        replace(HOT, asset="bench-2"),
        replace(HOT, kind="forecast limit", predicted=True, lead_time_s=60.0, probability=0.4),
        replace(HOT, channel="t_outer_ring_c"),
        replace(HOT, level="warning", priority=2),
    ]
    for condition in [HOT, *others]:
        assert bench.after(1, condition) == "UNACK"
    assert len(bench.book.active()) == 5
    assert [alarm.priority for alarm in bench.book.active()] == [1, 1, 1, 1, 2]
    assert [alarm.asset for alarm in bench.book.active("bench-2")] == ["bench-2"]
    assert bench.after(1, COLD) == "RTNUN"
    assert [bench.state(other) for other in others] == ["UNACK"] * 4


def test_figures_of_a_standing_alarm_stay_fresh_and_only_news_is_told(bench: Bench) -> None:
    soon = replace(
        HOT, kind="forecast limit", predicted=True, lead_time_s=600.0, probability=0.3, value=None
    )
    bench.after(0, soon)
    bench.after(60, replace(soon, lead_time_s=540.0, probability=0.5))
    assert (bench.only().lead_time_s, bench.only().probability) == (540.0, 0.5)
    assert len(bench.told) == 1
    bench.after(60, replace(soon, message="will pass 105 °C", lead_time_s=480.0))
    assert bench.told[-1].message == "will pass 105 °C"
    assert len(bench.told) == 2
    assert len(bench.journal()) == 1  # no change of state
    assert bench.store.alarms.load() == [bench.only()]


def test_alarms_survive_a_restart_in_every_state(bench: Bench) -> None:
    acked, returned = replace(HOT, channel="b"), replace(HOT, channel="c")
    for condition in (HOT, acked, returned):
        bench.after(1, condition)
    bench.book.acknowledge(next(a.id for a in bench.book.active() if a.channel == "b"), "eva")
    bench.after(1, replace(returned, active=False))
    before = bench.book.active()
    bench.restart()
    assert bench.book.active() == before
    assert {alarm.channel: alarm.state for alarm in before} == {
        "t_inner_ring_c": "UNACK",
        "b": "ACKED",
        "c": "RTNUN",
    }
    told = len(bench.told)
    assert bench.after(1, HOT) == "UNACK"  # still there: no news, no second alarm
    assert len(bench.told) == told
    assert bench.after(1, COLD) == "RTNUN"
    assert bench.after(1, replace(acked, active=False)) == "NORM"


def test_a_locked_store_makes_nobody_wait_and_gets_everything_later(bench: Bench) -> None:
    intruder = sqlite3.connect(bench.data_dir / FILE_NAME, isolation_level=None)
    intruder.execute("BEGIN EXCLUSIVE")
    bench.after(0, HOT)
    bench.book.acknowledge(bench.only().id, "eva")
    bench.after(1, COLD)
    assert not bench.outbox.flush(0.2)  # nothing is written, and yet they have gone on
    intruder.rollback()
    intruder.close()
    assert [line.to_state for line in bench.journal()] == ["UNACK", "ACKED", "NORM"]


@given(steps=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 20)), max_size=25))
@settings(max_examples=50, deadline=None)
def test_any_story_without_delays_follows_the_table(
    shared_bench: Bench, steps: list[tuple[int, int]]
) -> None:
    bench, asset = shared_bench, uuid.uuid4().hex
    truths = [replace(HOT, asset=asset), replace(COLD, asset=asset), replace(UNKNOWN, asset=asset)]
    expected = AlarmState.NORM
    for what, seconds in steps:
        bench.clock.advance(seconds)
        event = None
        if what == 3:
            if expected in ("UNACK", "RTNUN"):
                event = AlarmEvent.ACKNOWLEDGE
                (alarm,) = bench.book.active(asset)
                bench.book.acknowledge(alarm.id, "eva")
        else:
            bench.book.evaluate(truths[what])
            event = (AlarmEvent.RAISE, AlarmEvent.RETURN, None)[what]
        if event:
            expected = next_state(expected, event) or expected
        assert bench.state(truths[0]) == expected
        assert len(bench.book.active(asset)) == (expected != "NORM")
    journal = [line for line in bench.journal() if line.asset == asset]
    states = ["NORM", *(line.to_state for line in journal)]
    assert [line.from_state for line in journal] == states[:-1]
    assert states[-1] == expected
    kept = [alarm.state for alarm in bench.store.alarms.load() if alarm.asset == asset]
    assert kept == ([expected] if expected != "NORM" else [])


def test_documents_have_the_contracts_names(bench: Bench) -> None:
    bench.after(0, replace(HOT, predicted=True, lead_time_s=600.0, probability=0.25))
    bench.clock.advance(1.5)
    alarm = bench.book.acknowledge(bench.only().id, "eva", "seen")
    assert json.loads(alarm_document(alarm).to_bytes()) == {
        "id": alarm.id,
        "asset": "bench-1",
        "assets": ["bench-1"],
        "cause": {"kind": "step", "id": "bench-1"},
        "action": None,
        "kind": "measured limit",
        "channel": "t_inner_ring_c",
        "limit_level": "alarm",
        "priority": 1,
        "state": "ACKED",
        "active": True,
        "message": "Inner ring over alarm 105 °C",
        "raised_at": "2025-11-21T04:40:00.000Z",
        "since": "2025-11-21T04:40:01.500Z",
        "returned_at": None,
        "acknowledged_at": "2025-11-21T04:40:01.500Z",
        "acknowledged_by": "eva",
        "shelved_until": None,
        "shelved_by": None,
        "suppressed_reason": None,
        "latched": False,
        "comment": "seen",
        "value": 106.0,
        "limit_value": 105.0,
        "unit": "°C",
        "peak": {"value": 106.0, "time": "2025-11-21T04:40:00.000Z"},
        "duration_s": None,
        "predicted": True,
        "lead_time_s": 600.0,
        "probability": 0.25,
    }
    assert json.loads(transition_document(bench.journal()[-1], "°C").to_bytes()) == {
        "class": "alarm",
        "alarm_id": alarm.id,
        "asset": "bench-1",
        "assets": ["bench-1"],
        "kind": "measured limit",
        "channel": "t_inner_ring_c",
        "limit_level": "alarm",
        "priority": 1,
        "time": "2025-11-21T04:40:01.500Z",
        "event": "acknowledge",
        "from": "UNACK",
        "to": "ACKED",
        "who": "eva",
        "comment": "seen",
        "shelved_until": None,
        "value": 106.0,
        "unit": "°C",
        "peak": {"value": 106.0, "time": "2025-11-21T04:40:00.000Z"},
        "duration_s": None,
        "message": "Inner ring over alarm 105 °C",
    }


def test_the_list_goes_by_priority_whatever_the_kind(bench: Bench) -> None:
    lost = replace(HOT, kind="stale data", level="", priority=2, limit_value=None, value=None)
    for number in range(10):
        bench.book.evaluate(replace(lost, channel=f"t_node_{number}_c"))
    bench.clock.advance(1)
    bench.book.evaluate(replace(HOT, kind="forecast limit", predicted=True))
    bench.book.evaluate(replace(HOT, channel="t_outer_ring_c"))
    bench.book.acknowledge(bench.book.active()[0].id, "eva")
    bench.book.evaluate(HOT)
    bench.book.evaluate(replace(HOT, channel="t_node_1_c", suppressed_reason="why"))
    listed = [(one.kind, one.state, one.predicted) for one in bench.book.active()]
    assert listed[:4] == [
        ("measured limit", "UNACK", False),
        ("forecast limit", "UNACK", True),
        ("stale data", "UNACK", False),
        ("stale data", "UNACK", False),
    ]
    assert listed[-2] == ("measured limit", "ACKED", False), "nothing is left to answer there"
    assert listed[-1] == ("measured limit", "DSUPR", False), "what is set aside comes last"


def test_a_limit_that_is_exceeded_counts_while_its_data_are_lost(bench: Bench) -> None:
    assert alarm_summary(bench.book.active()).over_limit is None
    bench.book.evaluate(replace(HOT, level="warning", priority=2))
    assert alarm_summary(bench.book.active()).over_limit == "warning"
    bench.book.evaluate(HOT)
    bench.book.evaluate(UNKNOWN)
    bench.book.evaluate(replace(HOT, kind="stale data", level="", priority=2, channel="source:a"))
    found = alarm_summary(bench.book.active())
    assert found.over_limit == "alarm"
    assert (found.active, found.highest_priority) == (3, 1)


def peak_of(bench: Bench) -> float | None:
    peak = alarm_document(bench.only()).peak
    return None if peak is None else peak.value


def test_a_returned_alarm_has_its_peak_and_how_long_it_lasted(bench: Bench) -> None:
    bench.after(0, HOT)
    bench.after(600, replace(HOT, value=113.4))
    peak_us = bench.clock.us
    bench.after(600, replace(HOT, value=108.0))
    assert alarm_document(bench.only()).duration_s is None, "it stands"
    bench.after(60, UNKNOWN)
    bench.after(60, COLD)
    returned = alarm_document(bench.only())
    assert returned.state == "RTNUN"
    assert returned.peak == Peak(value=113.4, time=rfc3339(peak_us))
    assert returned.duration_s == 1320.0
    line = transition_document(bench.journal()[-1], None)
    assert (line.peak, line.duration_s) == (returned.peak, 1320.0)
    bench.after(600, replace(HOT, value=115.0))
    assert peak_of(bench) == 115.0, "raised again in the same life"
    bench.after(60, COLD)
    bench.book.acknowledge(bench.only().id, "eva")
    bench.after(60, HOT)
    assert peak_of(bench) == HOT.value, "a new life"


def test_the_peak_outlives_a_restart(bench: Bench) -> None:
    bench.after(0, replace(HOT, value=120.0))
    bench.restart()
    bench.after(10, HOT)
    bench.after(10, COLD)
    assert peak_of(bench) == 120.0
