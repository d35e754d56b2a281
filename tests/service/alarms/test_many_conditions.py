"""Many conditions in one call: what rests is only noted, and must be as if it were judged."""

import time
from dataclasses import asdict, replace
from typing import Any

import pytest
from alarm_bench import COLD, HOT, UNKNOWN, Bench
from hypothesis import given, settings
from hypothesis import strategies as st

from service.alarms import UnknownAlarmError
from service.alarms.register import Watched
from service.store import Alarm

OTHER = replace(COLD, channel="t_outer_ring_c")


def look(bench: Bench) -> Alarm:
    """The normal alarm as somebody sees it who looks."""
    (alarm,) = bench.book.normal()
    return alarm


def test_figures_follow_while_the_alarm_is_normal(bench: Bench) -> None:
    bench.after(0, COLD)
    alarm_id = look(bench).id
    for value in (81.0, 85.0, 83.5):
        bench.after(1, replace(COLD, value=value, message=f"at {value}"))
        seen = look(bench)
        assert (seen.value, seen.message, seen.id) == (value, f"at {value}", alarm_id)
        assert bench.book.alarm(alarm_id) == seen
    bench.after(1, UNKNOWN)
    assert look(bench).value == 83.5, "what was last known"
    bench.after(1, replace(HOT, on_delay_s=60.0))
    assert look(bench).value == 83.5, "of when it was normal"
    assert bench.told == []


def test_what_is_set_aside_while_it_rests_has_its_latest_figures(bench: Bench) -> None:
    for value in (81.0, 84.0):
        bench.after(1, replace(COLD, value=value))
    shelved = bench.book.shelve(look(bench).id, 600, "eva")
    assert (shelved.state, shelved.value) == ("SHLVD", 84.0)
    bench.after(1, replace(COLD, value=85.0))
    assert bench.book.normal() == []
    assert bench.only() == shelved


@pytest.mark.parametrize("quiet", [COLD, UNKNOWN])
def test_an_alarm_comes_after_long_rest_with_its_whole_delay(bench: Bench, quiet: Any) -> None:
    slow = replace(HOT, on_delay_s=10.0)
    for _ in range(100):
        bench.book.evaluate_all([quiet, OTHER])
        bench.clock.advance(1)
    bench.book.evaluate_all([slow, OTHER])
    bench.clock.advance(9.9)
    bench.book.evaluate_all([slow, OTHER])
    assert bench.book.active() == []
    bench.clock.advance(0.1)
    bench.book.evaluate_all([slow, OTHER])
    assert bench.only().raised_at_us == bench.clock.us
    assert bench.told == [bench.only()]


def test_a_delay_that_ran_when_the_condition_went_begins_again(bench: Bench) -> None:
    slow = replace(HOT, on_delay_s=10.0)
    bench.after(0, slow)
    bench.after(9, slow)
    for _ in range(5):
        bench.after(1, COLD)
    assert bench.after(1, slow) == "NORM"
    assert bench.after(9, slow) == "NORM"
    assert bench.after(1, slow) == "UNACK"


def test_a_delay_that_waits_does_not_rest(bench: Bench) -> None:
    slow = replace(HOT, on_delay_s=10.0)
    bench.after(0, slow)
    bench.after(9, slow)
    for _ in range(5):
        bench.after(100, UNKNOWN)
    assert bench.after(1, slow) == "NORM", "the time without data does not count"
    assert bench.after(1, slow) == "UNACK"


def test_shelving_ends_by_time_while_nothing_is_active(bench: Bench) -> None:
    bench.after(0, COLD)
    bench.book.shelve(look(bench).id, 600, "eva")
    bench.clock.advance(599)
    bench.book.evaluate_all([OTHER])
    assert bench.only().state == "SHLVD"
    bench.clock.advance(1)
    bench.book.evaluate_all([OTHER])
    assert [alarm.state for alarm in bench.told] == ["SHLVD", "NORM"]
    assert bench.journal()[-1].comment == "the shelving time has expired"
    assert bench.after(1, HOT) == "UNACK"


def test_what_is_there_is_known_by_asset(bench: Bench) -> None:
    key = HOT.key[1:]
    bench.after(0, COLD)
    assert bench.book.present(HOT.asset) == frozenset()
    bench.after(1, HOT)
    bench.book.shelve(bench.only().id, 600, "eva")
    bench.after(1, replace(HOT, asset="bench-2", channel="b"))
    assert bench.book.present(HOT.asset) == {key}, "whatever people have said"
    bench.restart()
    assert bench.book.present(HOT.asset) == {key}
    assert HOT.key[1:] in bench.book.present(HOT.asset)
    bench.after(1, COLD)
    assert bench.book.present(HOT.asset) == frozenset()
    assert bench.book.present("bench-2") == {("measured limit", "b", "alarm")}
    bench.book.withdraw("bench-2", ())
    assert bench.book.present("bench-2") == frozenset()


def test_what_is_forgotten_begins_again(bench: Bench) -> None:
    for value in (81.0, 84.0):
        bench.after(1, replace(COLD, value=value))
    bench.after(1, HOT)
    before = bench.only().id
    bench.book.forget(["bench-1"])
    assert (bench.book.active(), bench.book.normal()) == ([], [])
    bench.after(1, COLD)
    assert look(bench).id != before


# ------------------------------------------------------------------ one call, and all judged
PARTS = [("a", 0.0), ("b", 7.0), ("c", 0.0)]


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Any:
    benches = [Bench(tmp_path_factory.mktemp(name)) for name in ("one", "many")]
    yield benches
    for bench in benches:
        bench.close()


def known(bench: Bench) -> list[dict[str, Any]]:
    """Every alarm without its id, which is random."""
    alarms = sorted(
        (*bench.book.active(), *bench.book.normal()), key=lambda one: (one.asset, one.channel)
    )
    return [asdict(alarm) | {"id": ""} for alarm in alarms]


@given(
    steps=st.lists(
        st.tuples(
            st.tuples(*[st.sampled_from([106.0, 104.5, 80.0, 81.0, None])] * len(PARTS)),
            st.booleans(),
            st.sampled_from([0, 1, 5, 40]),
            st.sampled_from(["", "", "acknowledge", "shelve"]),
        ),
        max_size=25,
    )
)
@settings(max_examples=60, deadline=None)
def test_one_call_does_what_judging_each_does(pair: list[Bench], steps: list[Any]) -> None:
    one, many = pair
    for bench in pair:
        bench.book.forget(["bench-1"])
        bench.clock.us = max(one.clock.us, many.clock.us)
        bench.told.clear()
    for values, hidden, seconds, what in steps:
        conditions = [
            replace(
                HOT,
                channel=channel,
                active=None if value is None else value >= 105.0,
                value=value,
                deadband=1.0,
                on_delay_s=delay_s,
                off_delay_s=delay_s,
                re_alarm_s=60.0,
                suppressed_reason="why" if hidden else None,
            )
            for (channel, delay_s), value in zip(PARTS, values, strict=True)
        ]
        for bench in pair:
            bench.clock.advance(seconds)
        one.book.evaluate_all(conditions)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Watched, "rests", False)
            for condition in conditions:
                many.book.evaluate(condition)
        for bench in pair if what else ():
            for alarm in sorted(bench.book.active(), key=lambda one: one.channel):
                if what == "shelve":
                    bench.book.shelve(alarm.id, 30, "eva")
                elif alarm.state in ("UNACK", "RTNUN"):
                    bench.book.acknowledge(alarm.id, "eva")
        assert known(one) == known(many)
        assert [alarm.state for alarm in one.told] == [alarm.state for alarm in many.told]


# ------------------------------------------------------------------ thousands of conditions
def many(bench: Bench, assets: int, each: int, active: bool) -> None:
    for number in range(assets):
        bench.book.evaluate_all(
            replace(HOT if active else COLD, asset=f"asset-{number}", channel=f"c-{channel}")
            for channel in range(each)
        )


def test_an_unknown_alarm_is_refused_without_a_look_at_all_conditions(bench: Bench) -> None:
    many(bench, 1000, 20, active=False)
    begun_s = time.thread_time()
    for number in range(500):
        with pytest.raises(UnknownAlarmError):
            bench.book.comment(f"{number:032x}", "eva", "why")
    # A look through all of them takes 0.7 ms for each.
    assert time.thread_time() - begun_s < 0.05


def test_what_is_asked_of_one_machine_costs_the_same_beside_hundreds_of_others(
    bench: Bench,
) -> None:
    def seconds() -> float:
        begun_s = time.thread_time()
        for _ in range(100):
            assert len(bench.book.active("asset-0")) == 20
        return time.thread_time() - begun_s

    many(bench, 1, 20, active=True)
    alone_s = min(seconds() for _ in range(5))
    many(bench, 300, 20, active=True)
    assert min(seconds() for _ in range(5)) < 3 * alone_s


def test_alarms_whose_shelving_ends_at_once_come_back_in_portions(bench: Bench) -> None:
    many(bench, 1, 50, active=True)
    for alarm in bench.book.active():
        bench.book.shelve(alarm.id, 600, "eva")
    bench.clock.advance(600)
    states = []
    while not states or "SHLVD" in states[-1]:
        states.append([alarm.state for alarm in bench.book.active()])
        assert len(states) < 10
    assert [one.count("UNACK") for one in states] == [20, 40, 50]
    assert len([line for line in bench.journal() if line.event == "unshelve"]) == 50


def test_a_shelving_ends_also_when_the_clock_is_set_back_after_others_were_looked_at(
    bench: Bench,
) -> None:
    many(bench, 1, 2, active=True)
    first, second = bench.book.active()
    bench.book.shelve(first.id, 600, "eva")
    bench.book.shelve(second.id, 8 * 3600, "eva")
    bench.clock.advance(700)
    assert sorted(one.state for one in bench.book.active()) == ["SHLVD", "UNACK"]
    bench.clock.advance(-24 * 3600)
    assert [one.state for one in bench.book.active()] == ["UNACK", "UNACK"]


def test_a_cell_that_leaves_machines_knows_nothing_of_their_open_alarms(bench: Bench) -> None:
    bench.after(1, HOT)
    bench.book.shelve(bench.only().id, 600, "eva")
    bench.after(1, replace(HOT, channel="b"))
    (alarm_id,) = [one.id for one in bench.book.active() if one.channel == "b"]
    bench.book.leave([HOT.asset])
    assert bench.book.active() == []
    with pytest.raises(UnknownAlarmError):
        bench.book.acknowledge(alarm_id, "eva")
    bench.clock.advance(3600)
    assert bench.after(1, replace(COLD, asset="another")) == "NORM"
    assert [one.state for one in bench.told] == ["UNACK", "SHLVD", "UNACK"], "of another cell now"
