"""The life of an alarm as a table: ISA-18.2 / IEC 62682, figure "alarm state transitions".

The table is the only place that says what an event does to an alarm; `docs/operate/alarms.md` shows
it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum


class AlarmState(StrEnum):
    """States with the standard's mnemonics, and one for latched alarms."""

    NORM = "NORM"
    """Normal: the condition is not there and nothing waits for acknowledgement."""
    UNACK = "UNACK"
    """The condition is there and no one has acknowledged it."""
    ACKED = "ACKED"
    """The condition is there and someone has acknowledged it."""
    RTNUN = "RTNUN"
    """Returned to normal, but never acknowledged."""
    LATCH = "LATCH"
    """Returned to normal and acknowledged; a latched alarm that waits for its reset."""
    SHLVD = "SHLVD"
    """Shelved by an operator, for a time."""
    DSUPR = "DSUPR"
    """Suppressed by design: another fact makes it meaningless."""
    OOSRV = "OOSRV"
    """Taken out of service by an engineer."""


class AlarmEvent(StrEnum):
    """What can happen to an alarm."""

    RAISE = "raise"
    RETURN = "return to normal"
    RE_ALARM = "re-alarm"
    ACKNOWLEDGE = "acknowledge"
    RESET = "reset"
    SHELVE = "shelve"
    UNSHELVE = "unshelve"
    SUPPRESS = "suppress"
    UNSUPPRESS = "unsuppress"
    TAKE_OUT = "out of service"
    PUT_BACK = "return to service"


@dataclass(frozen=True, slots=True)
class Transition:
    """One row of the table.

    - ``present``: only while the condition is there (is not); None: either way.
    - ``latched``: only for an alarm that is latched and has been raised (is not); None: either way.
    """

    state: AlarmState
    event: AlarmEvent
    target: AlarmState
    present: bool | None = None
    latched: bool | None = None


#: States in which the condition of the alarm is there, and operators are informed.
ACTIVE_STATES = frozenset({AlarmState.UNACK, AlarmState.ACKED})
#: States that wait for an operator's acknowledgement.
UNACKNOWLEDGED_STATES = frozenset({AlarmState.UNACK, AlarmState.RTNUN})
#: States in which operators are not informed, whatever the condition does.
SET_ASIDE_STATES = frozenset({AlarmState.SHLVD, AlarmState.DSUPR, AlarmState.OOSRV})


def _rows() -> Iterator[Transition]:
    state, event = AlarmState, AlarmEvent
    yield Transition(state.NORM, event.RAISE, state.UNACK)
    yield Transition(state.UNACK, event.ACKNOWLEDGE, state.ACKED)
    yield Transition(state.UNACK, event.RETURN, state.RTNUN)
    yield Transition(state.ACKED, event.RE_ALARM, state.UNACK)
    yield Transition(state.RTNUN, event.RAISE, state.UNACK)
    yield Transition(state.LATCH, event.RAISE, state.UNACK)
    yield Transition(state.LATCH, event.RESET, state.NORM)
    for before, over in ((state.ACKED, event.RETURN), (state.RTNUN, event.ACKNOWLEDGE)):
        yield Transition(before, over, state.NORM, latched=False)
        yield Transition(before, over, state.LATCH, latched=True)
    for before in state:
        if before != state.OOSRV:
            yield Transition(before, event.SHELVE, state.SHLVD)  # shelved again: for longer
            yield Transition(before, event.TAKE_OUT, state.OOSRV)
        if before not in SET_ASIDE_STATES:
            yield Transition(before, event.SUPPRESS, state.DSUPR)
    for before, back in (
        (state.SHLVD, event.UNSHELVE),
        (state.DSUPR, event.UNSUPPRESS),
        (state.OOSRV, event.PUT_BACK),
    ):
        yield Transition(before, back, state.UNACK, present=True)
        yield Transition(before, back, state.NORM, present=False, latched=False)
        yield Transition(before, back, state.LATCH, present=False, latched=True)


TRANSITIONS: tuple[Transition, ...] = tuple(_rows())

_BY_CAUSE = {
    (row.state, row.event, present, latched): row.target
    for row in TRANSITIONS
    for present in (False, True)
    for latched in (False, True)
    if row.present in (None, present) and row.latched in (None, latched)
}


def next_state(
    state: AlarmState, event: AlarmEvent, *, present: bool = False, latched: bool = False
) -> AlarmState | None:
    """Where an event leads; None where it means nothing in that state.

    ``latched``: whether the alarm is a latched one that has been raised.
    """
    return _BY_CAUSE.get((state, event, present, latched))
