import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.alarms import (
    ACTIVE_STATES,
    SET_ASIDE_STATES,
    TRANSITIONS,
    AlarmEvent,
    AlarmState,
    next_state,
)

NORM, UNACK, ACKED, RTNUN, LATCH, SHLVD, DSUPR, OOSRV = AlarmState
RAISE, RETURN, RE_ALARM, ACK, RESET, SHELVE, UNSHELVE, SUPPRESS, UNSUPPRESS, OUT, BACK = AlarmEvent

# The standard's figure, written down a second time: state -> event -> target; a pair is (condition
# gone, condition there). What is not named means nothing.
PLAIN = {
    NORM: {RAISE: UNACK, SHELVE: SHLVD, SUPPRESS: DSUPR, OUT: OOSRV},
    UNACK: {ACK: ACKED, RETURN: RTNUN, SHELVE: SHLVD, SUPPRESS: DSUPR, OUT: OOSRV},
    ACKED: {RETURN: NORM, RE_ALARM: UNACK, SHELVE: SHLVD, SUPPRESS: DSUPR, OUT: OOSRV},
    RTNUN: {ACK: NORM, RAISE: UNACK, SHELVE: SHLVD, SUPPRESS: DSUPR, OUT: OOSRV},
    LATCH: {RESET: NORM, RAISE: UNACK, SHELVE: SHLVD, SUPPRESS: DSUPR, OUT: OOSRV},
    SHLVD: {UNSHELVE: (NORM, UNACK), SHELVE: SHLVD, OUT: OOSRV},
    DSUPR: {UNSUPPRESS: (NORM, UNACK), SHELVE: SHLVD, OUT: OOSRV},
    OOSRV: {BACK: (NORM, UNACK)},
}
# What is different for a latched alarm that has been raised.
LATCHED = {
    (ACKED, RETURN): LATCH,
    (RTNUN, ACK): LATCH,
    (SHLVD, UNSHELVE): (LATCH, UNACK),
    (DSUPR, UNSUPPRESS): (LATCH, UNACK),
    (OOSRV, BACK): (LATCH, UNACK),
}


@pytest.mark.parametrize("present", [False, True])
@pytest.mark.parametrize("latched", [False, True])
@pytest.mark.parametrize(("state", "event"), list(itertools.product(AlarmState, AlarmEvent)))
def test_every_event_in_every_state(
    state: AlarmState, event: AlarmEvent, latched: bool, present: bool
) -> None:
    expected = PLAIN[state].get(event)
    if latched:
        expected = LATCHED.get((state, event), expected)
    if isinstance(expected, tuple):
        expected = expected[present]
    assert next_state(state, event, present=present, latched=latched) is expected


def test_the_states_have_the_standard_mnemonics() -> None:
    standard = ["NORM", "UNACK", "ACKED", "RTNUN", "SHLVD", "DSUPR", "OOSRV"]
    assert [state for state in AlarmState if state != LATCH] == standard


def test_no_row_says_the_same_twice_or_contradicts_another() -> None:
    causes = [
        (row.state, row.event, present, latched)
        for row in TRANSITIONS
        for present in (False, True)
        for latched in (False, True)
        if row.present in (None, present) and row.latched in (None, latched)
    ]
    assert len(causes) == len(set(causes))


@given(
    events=st.lists(st.tuples(st.sampled_from(AlarmEvent), st.booleans()), max_size=40),
    latched=st.booleans(),
)
def test_any_sequence_stays_in_the_table_and_finds_its_way_home(
    events: list[tuple[AlarmEvent, bool]], latched: bool
) -> None:
    state = NORM
    for event, present in events:
        state = next_state(state, event, present=present, latched=latched) or state
        assert state in AlarmState
        assert latched or state is not LATCH
    # The condition goes, people do what can be done: every alarm is over in the end.
    for event in (UNSHELVE, UNSUPPRESS, BACK, RETURN, ACK, RESET):
        state = next_state(state, event, present=False, latched=latched) or state
    assert state is NORM


@given(
    state=st.sampled_from(sorted(SET_ASIDE_STATES)),
    event=st.sampled_from(AlarmEvent),
    present=st.booleans(),
)
def test_what_is_set_aside_is_told_to_nobody_until_it_is_brought_back(
    state: AlarmState, event: AlarmEvent, present: bool
) -> None:
    target = next_state(state, event, present=present)
    if event in (UNSHELVE, UNSUPPRESS, BACK):
        assert (target in ACTIVE_STATES) == present or target is None
    else:
        assert target is None or target in SET_ASIDE_STATES
