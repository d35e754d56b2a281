"""Alarms: the state machine of ISA-18.2 / IEC 62682 and the book of present alarms."""

from service.alarms.book import AlarmBook, UnknownAlarmError
from service.alarms.conditions import AlarmCondition, AlarmKind, Priority
from service.alarms.documents import alarm_document, transition_document
from service.alarms.states import (
    ACTIVE_STATES,
    TRANSITIONS,
    UNACKNOWLEDGED_STATES,
    AlarmEvent,
    AlarmState,
    next_state,
)

__all__ = [
    "ACTIVE_STATES",
    "TRANSITIONS",
    "UNACKNOWLEDGED_STATES",
    "AlarmBook",
    "AlarmCondition",
    "AlarmEvent",
    "AlarmKind",
    "AlarmState",
    "Priority",
    "UnknownAlarmError",
    "alarm_document",
    "next_state",
    "transition_document",
]
