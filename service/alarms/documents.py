"""Alarms and their journal as JSON documents, as the API and the stream show them."""

from typing import Any

from service.alarms.lives import duration_s
from service.clock import rfc3339
from service.store import Alarm, AlarmTransition


def alarm_document(alarm: Alarm) -> dict[str, Any]:
    """Show one alarm as plain JSON types; times as RFC 3339."""
    return {
        "id": alarm.id,
        "asset": alarm.asset,
        "kind": alarm.kind,
        "channel": alarm.channel,
        "limit_level": alarm.level or None,
        "priority": alarm.priority,
        "state": str(alarm.state),
        "active": alarm.present,
        "message": alarm.message,
        "raised_at": _time(alarm.raised_at_us or None),
        "since": rfc3339(alarm.since_us),
        "returned_at": _time(alarm.returned_at_us),
        "acknowledged_at": _time(alarm.acknowledged_at_us),
        "acknowledged_by": alarm.acknowledged_by,
        "shelved_until": _time(alarm.shelved_until_us),
        "shelved_by": alarm.shelved_by,
        "suppressed_reason": alarm.suppressed_reason,
        "latched": alarm.latched,
        "comment": alarm.comment,
        "value": alarm.value,
        "limit_value": alarm.limit_value,
        "unit": alarm.unit,
        "peak": _peak(alarm.peak_value, alarm.peak_at_us),
        "duration_s": duration_s(alarm),
        "predicted": alarm.predicted,
        "lead_time_s": alarm.lead_time_s,
        "probability": alarm.probability,
    }


def transition_document(line: AlarmTransition) -> dict[str, Any]:
    """Show one line of the journal as plain JSON types; times as RFC 3339."""
    return {
        "class": "alarm" if line.alarm_id else "event",
        "alarm_id": line.alarm_id,
        "asset": line.asset,
        "kind": line.kind,
        "channel": line.channel or None,
        "limit_level": line.level or None,
        "priority": line.priority,
        "time": rfc3339(line.time_us),
        "event": line.event or None,
        "from": line.from_state or None,
        "to": line.to_state or None,
        "who": line.who,
        "comment": line.comment,
        "shelved_until": _time(line.until_us),
        "value": line.value,
        "peak": _peak(line.peak_value, line.peak_at_us),
        "duration_s": line.duration_s,
        "message": line.message,
    }


def _peak(value: float | None, time_us: int | None) -> dict[str, Any] | None:
    return None if value is None else {"value": value, "time": _time(time_us)}


def _time(time_us: int | None) -> str | None:
    return None if time_us is None else rfc3339(time_us)
