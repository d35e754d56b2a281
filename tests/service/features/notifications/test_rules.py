"""Whatever happens to an alarm, its recipient knows in the end whether it is there, once."""

from dataclasses import replace as replaced
from datetime import UTC, datetime

import hypothesis
import pytest
from alarm_bench import STORED
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from service.alarms import ACTIVE_STATES, SET_ASIDE_STATES, AlarmEvent, AlarmState
from service.alarms.records import following
from service.alarms.silencing import Silencing
from service.clock import MICROSECONDS
from service.features.notifications import rules
from service.features.notifications.sections import NotificationSection, QuietHours
from service.features.notifications.tables import Notification

MAIL = NotificationSection(id="mail", kind="email", to=("a@example.com",))
HOOK = NotificationSection(id="hook", kind="webhook", url="https://example.com/hook")
NORMAL = replaced(STORED, state="NORM", present=False, raised_at_us=0)
PRESENT = {AlarmEvent.RAISE: True, AlarmEvent.RETURN: False}

steps = st.lists(
    st.sampled_from(
        [
            *AlarmEvent,
            *["come", "go", "hold", "release", "send", "begin", "finish", "part", "escalate"],
        ],
    ),
    min_size=30,
    max_size=60,
)


@hypothesis.settings(max_examples=300)
@given(steps, st.sampled_from([MAIL, HOOK]))
# A return is under way while the alarm is raised and returns once more: the second is no news.
@hypothesis.example(
    [
        *(AlarmEvent.RAISE, "send", AlarmEvent.TAKE_OUT, "begin"),
        *(AlarmEvent.PUT_BACK, AlarmEvent.RETURN, "finish", AlarmEvent.RAISE),
    ],
    MAIL,
)
def test_what_was_sent_is_once_and_true(
    happens: list[AlarmEvent | str], section: NotificationSection
) -> None:
    alarm, notification, held, now_us = NORMAL, None, False, 1000
    said: list[str] = []
    calls = 0
    flight: tuple[str, ...] = ()  # under way to the receiver
    at_first: list[str] = []  # what an address has that others may have later

    def release(one: Notification | None) -> Notification | None:
        if one is None or one.released_us is not None or one.over:
            return one
        return replace(one, released_us=now_us)

    def begin(one: Notification | None) -> tuple[str, ...]:
        events = rules.due(one, Silencing(), now_us) if one else ()
        said.extend(events)
        at_first.extend(event for event in events if event not in at_first)
        return events

    for what in [*happens, "finish", "release", "send", "send"]:
        now_us += 1
        if what in ("hold", "release"):
            held = what == "hold"
        elif what in ("come", "go"):  # unseen, while the alarm is set aside
            if alarm.state in SET_ASIDE_STATES:
                alarm = replaced(alarm, present=what == "come")
        elif what == "escalate":
            if notification and notification.released_us and alarm.state == "UNACK":
                notification = rules.escalated(notification, notification, section.id, now_us)
                notification = replace(notification, steps=notification.steps + 1)
        elif what == "part":
            if notification and not flight:
                events = rules.due(notification, Silencing(), now_us)
                at_first.extend(event for event in events if event not in at_first)
                notification = rules.partly_sent(notification, events) if events else notification
        elif what not in ("send", "begin", "finish"):
            event = AlarmEvent(what)
            alarm_then = replaced(alarm, present=PRESENT.get(event, alarm.present))
            state = following(alarm_then, event)
            if state is None:
                continue
            alarm = replaced(alarm_then, state=state.value, since_us=now_us)
            calls += state == AlarmState.UNACK
            notification = rules.updated(notification, alarm, section, selected=True)
            if event == AlarmEvent.RE_ALARM and notification and notification.is_notified:
                kinds = [rules.kind_of(one) for one in notification.pending]
                assert "raised" in kinds, "it calls again"
                assert "acknowledged" not in kinds
        notification = notification if held else release(notification)
        if what == "begin" and not flight:
            flight = begin(notification)
        if what in ("finish", "send") and flight and notification:
            notification, flight = rules.sent(notification, flight), ()
        if what == "send":
            events = begin(notification)
            notification = (
                rules.sent(notification, events) if notification and events else notification
            )
            if notification and notification.pending:
                continue
            assert len(set(said)) == len(said), "an event was sent twice"
            assert sum(rules.kind_of(one) == "raised" for one in said) <= calls
            knows_of_it = notification is not None and notification.is_notified
            has_it = bool(at_first) and rules.kind_of(at_first[-1]) != "returned"
            if alarm.state == AlarmState.UNACK and not held:
                assert knows_of_it
                assert has_it, (at_first, said)
            elif alarm.state not in ACTIVE_STATES:
                assert not knows_of_it, (alarm.state, said)
                assert not has_it, (alarm.state, at_first, said)
        if notification and notification.over and not flight:
            notification = None
        if alarm.state == AlarmState.NORM and notification is None:
            said, at_first, calls = [], [], 0  # the next life has another id
    assert notification is None or not notification.pending


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


def test_an_alarm_that_is_back_before_its_return_is_sent_makes_no_message() -> None:
    there = replaced(STORED, state="UNACK", since_us=1)
    notification = rules.updated(None, there, MAIL, selected=True)
    assert notification is not None
    notification = rules.sent(replace(notification, released_us=1), notification.pending)
    gone = rules.updated(
        notification, replaced(there, state="RTNUN", present=False), MAIL, selected=True
    )
    assert gone is not None
    assert gone.pending == ("returned:1",)
    back = rules.updated(gone, replaced(there, since_us=9), MAIL, selected=True)
    assert back is not None
    assert (back.pending, back.is_notified, back.released_us) == ((), True, 1)


@pytest.mark.parametrize("sees", ["before", "meanwhile"])
def test_an_address_that_knows_of_a_return_is_called_again(sees: str) -> None:
    """Another address has neither the raise nor the return yet."""
    alarm = replaced(NORMAL, state="UNACK", present=True, since_us=1)
    raised = rules.updated(None, alarm, MAIL, selected=True)
    assert raised is not None
    raised = rules.partly_sent(replace(raised, released_us=1), raised.pending)
    returned = rules.updated(
        raised, replaced(alarm, state="RTNUN", present=False), MAIL, selected=True
    )
    assert returned is not None
    assert returned.pending == ("raised:1", "returned:1")
    if sees == "before":
        returned = rules.partly_sent(returned, ["returned:1"])
    again = rules.updated(returned, replaced(alarm, since_us=2), MAIL, selected=True)
    assert again is not None
    if sees == "meanwhile":
        assert again.pending == ("raised:1",), "no address has the return"
        again = rules.partly_sent(again, ["returned:1"])
    assert set(again.pending) == {"raised:1", "returned:1", "raised:2"}
    assert again.pending[-1] == "raised:2"
    done = rules.sent(again, again.pending)
    assert (done.pending, done.partly, done.is_notified) == ((), (), True)
