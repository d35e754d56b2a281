"""Whatever happens to an alarm, its receiver knows in the end whether it is there, once."""

from dataclasses import replace
from datetime import UTC, datetime

import hypothesis
import pytest
from alarm_bench import STORED
from hypothesis import given
from hypothesis import strategies as st

from service.alarms import ACTIVE_STATES, SET_ASIDE_STATES, AlarmEvent, AlarmState
from service.alarms.records import following
from service.clock import MICROSECONDS
from service.notifications import rules
from service.site.notification_section import NotificationSection, QuietHours
from service.store import Silence, Telling

MAIL = NotificationSection(id="mail", kind="email", to=("a@example.com",))
HOOK = NotificationSection(id="hook", kind="webhook", url="https://example.com/hook")
NORMAL = replace(STORED, state="NORM", present=False, raised_at_us=0)
PRESENT = {AlarmEvent.RAISE: True, AlarmEvent.RETURN: False}

steps = st.lists(
    st.sampled_from(
        [*AlarmEvent, "come", "go", "hold", "release", "send", "begin", "finish", "escalate"]
    ),
    min_size=30,
    max_size=60,
)


@hypothesis.settings(max_examples=300)
@given(steps, st.sampled_from([MAIL, HOOK]))
def test_what_was_told_is_once_and_true(
    happens: list[AlarmEvent | str], section: NotificationSection
) -> None:
    alarm, telling, held, now_us = NORMAL, None, False, 1000
    said: list[str] = []
    calls = 0
    flight: tuple[str, ...] = ()  # under way to the receiver

    def release(one: Telling | None) -> Telling | None:
        if one is None or one.released_us is not None or one.over:
            return one
        return replace(one, released_us=now_us)

    def begin(one: Telling | None) -> tuple[str, ...]:
        events = rules.due(one, (), now_us) if one else ()
        said.extend(events)
        return events

    for what in [*happens, "finish", "release", "send", "send"]:
        now_us += 1
        if what in ("hold", "release"):
            held = what == "hold"
        elif what in ("come", "go"):  # unseen, while the alarm is set aside
            if alarm.state in SET_ASIDE_STATES:
                alarm = replace(alarm, present=what == "come")
        elif what == "escalate":
            if telling and telling.released_us and alarm.state == "UNACK":
                telling = rules.escalated(telling, telling, section.id, now_us)
                telling = replace(telling, steps=telling.steps + 1)
        elif what not in ("send", "begin", "finish"):
            event = AlarmEvent(what)
            alarm_then = replace(alarm, present=PRESENT.get(event, alarm.present))
            state = following(alarm_then, event)
            if state is None:
                continue
            alarm = replace(alarm_then, state=state.value, since_us=now_us)
            calls += state == AlarmState.UNACK
            telling = rules.noted(telling, alarm, section, wanted=True)
            if event == AlarmEvent.RE_ALARM and telling and telling.told:
                kinds = [rules.kind_of(one) for one in telling.owed]
                assert "raised" in kinds, "it calls again"
                assert "acknowledged" not in kinds
        telling = telling if held else release(telling)
        if what == "begin" and not flight:
            flight = begin(telling)
        if what in ("finish", "send") and flight and telling:
            telling, flight = rules.sent(telling, flight), ()
        if what == "send":
            events = begin(telling)
            telling = rules.sent(telling, events) if telling and events else telling
            if telling and telling.owed:
                continue
            assert len(set(said)) == len(said), "an event was told twice"
            assert sum(rules.kind_of(one) == "raised" for one in said) <= calls
            knows_of_it = telling is not None and telling.told
            if alarm.state == AlarmState.UNACK and not held:
                assert knows_of_it
            elif alarm.state not in ACTIVE_STATES:
                assert not knows_of_it, (alarm.state, said)
        if telling and telling.over and not flight:
            telling = None
        if alarm.state == AlarmState.NORM and telling is None:
            said, calls = [], 0  # the next life has another id
    assert telling is None or not telling.owed


def at(text: str) -> int:
    return int(datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()) * MICROSECONDS


QUIET = QuietHours.model_validate(
    {"begins": "22:00", "ends": "06:00", "time_zone": "Europe/Berlin"}
)


@pytest.mark.parametrize(
    ("time", "quiet"),
    [
        ("2026-01-10T20:59:59", False),  # winter: one hour behind Berlin
        ("2026-01-10T21:00:00", True),
        ("2026-01-11T04:59:59", True),
        ("2026-01-11T05:00:00", False),
        ("2026-07-10T20:00:00", True),  # summer: two
        ("2026-07-11T04:00:00", False),
    ],
)
def test_quiet_hours_are_those_of_the_place_and_never_hold_priority_1(
    time: str, quiet: bool
) -> None:
    assert rules.is_quiet(QUIET, 3, at(time)) is quiet
    assert not rules.is_quiet(QUIET, 1, at(time))


def test_a_weekly_silence_belongs_to_the_day_on_which_it_begins() -> None:
    saturdays = Silence(
        "s", ("bench-1",), at("2026-01-01T00:00"), at("2026-02-01T00:00"), "me", "inspection",
        days=(5,), begins="22:00", ends="02:00",
    )  # fmt: skip
    told = {
        time: not rules.is_silent("bench-1", [saturdays], at(time))
        for time in ("2026-01-10T21:59", "2026-01-10T22:00", "2026-01-11T01:59",
                     "2026-01-11T02:00", "2026-01-10T01:00", "2026-02-07T23:00")
    }  # fmt: skip
    assert list(told.values()) == [True, False, False, True, True, True]
    assert not rules.is_silent("bench-2", [saturdays], at("2026-01-10T22:00"))
    always = replace(saturdays, days=(), begins="", ends="", assets=())
    assert rules.is_silent("bench-2", [always], at("2026-01-10T12:00"))


def test_an_alarm_that_is_back_before_its_return_is_told_makes_no_message() -> None:
    there = replace(STORED, state="UNACK", since_us=1)
    telling = rules.noted(None, there, MAIL, wanted=True)
    assert telling is not None
    telling = rules.sent(replace(telling, released_us=1), telling.owed)
    gone = rules.noted(telling, replace(there, state="RTNUN", present=False), MAIL, wanted=True)
    assert gone is not None
    assert gone.owed == ("returned:1",)
    back = rules.noted(gone, replace(there, since_us=9), MAIL, wanted=True)
    assert back is not None
    assert (back.owed, back.told, back.released_us) == ((), True, 1)
