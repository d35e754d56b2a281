"""The life of an alarm as a table: ISA-18.2 / IEC 62682, figure "alarm state transitions".

The states shelved (SHLVD), suppressed by design (DSUPR) and out of service (OOSRV) of the
standard are further rows of the same table; the service has no such functions yet.
"""

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType


class AlarmState(StrEnum):
    """States with the standard's mnemonics."""

    NORM = "NORM"
    """Normal: the condition is not there and nothing waits for acknowledgement."""
    UNACK = "UNACK"
    """The condition is there and nobody has acknowledged it."""
    ACKED = "ACKED"
    """The condition is there and somebody has acknowledged it."""
    RTNUN = "RTNUN"
    """Returned to normal, but never acknowledged."""


class AlarmEvent(StrEnum):
    """What can happen to an alarm."""

    RAISE = "raise"
    RETURN = "return to normal"
    ACKNOWLEDGE = "acknowledge"


#: States in which the condition of the alarm is there.
ACTIVE_STATES = frozenset({AlarmState.UNACK, AlarmState.ACKED})
#: States that wait for an operator.
UNACKNOWLEDGED_STATES = frozenset({AlarmState.UNACK, AlarmState.RTNUN})

TRANSITIONS: Mapping[tuple[AlarmState, AlarmEvent], AlarmState] = MappingProxyType(
    {
        (AlarmState.NORM, AlarmEvent.RAISE): AlarmState.UNACK,
        (AlarmState.UNACK, AlarmEvent.ACKNOWLEDGE): AlarmState.ACKED,
        (AlarmState.UNACK, AlarmEvent.RETURN): AlarmState.RTNUN,
        (AlarmState.ACKED, AlarmEvent.RETURN): AlarmState.NORM,
        (AlarmState.RTNUN, AlarmEvent.ACKNOWLEDGE): AlarmState.NORM,
        (AlarmState.RTNUN, AlarmEvent.RAISE): AlarmState.UNACK,
    }
)


def next_state(state: AlarmState, event: AlarmEvent) -> AlarmState:
    """Where an event leads; an event that means nothing in a state leaves it as it is."""
    return TRANSITIONS.get((state, event), state)
