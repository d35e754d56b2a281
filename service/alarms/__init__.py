"""Alarms: the state machine of ISA-18.2 / IEC 62682 and the book of present alarms."""

from service.alarms.book import LONGEST_SHELVING_S, AlarmBook
from service.alarms.changes import SERVICE, NotAllowedError
from service.alarms.register import UnknownAlarmError
from service.alarms.shared import SharedCauses
from service.alarms.states import (
    ACTIVE_STATES,
    SET_ASIDE_STATES,
    TRANSITIONS,
    UNACKNOWLEDGED_STATES,
    AlarmEvent,
    AlarmState,
    Transition,
    next_state,
)
from service.domain.alarm_condition import AlarmCondition, EventKind, Priority

__all__ = [
    "ACTIVE_STATES",
    "LONGEST_SHELVING_S",
    "SERVICE",
    "SET_ASIDE_STATES",
    "TRANSITIONS",
    "UNACKNOWLEDGED_STATES",
    "AlarmBook",
    "AlarmCondition",
    "AlarmEvent",
    "AlarmState",
    "EventKind",
    "NotAllowedError",
    "Priority",
    "SharedCauses",
    "Transition",
    "UnknownAlarmError",
    "next_state",
]
