"""Alarms and their journal as JSON documents, as the API and the stream show them."""

from typing import Any

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
        "message": alarm.message,
        "raised_at": rfc3339(alarm.raised_at_us),
        "since": rfc3339(alarm.since_us),
        "returned_at": _time(alarm.returned_at_us),
        "acknowledged_at": _time(alarm.acknowledged_at_us),
        "acknowledged_by": alarm.acknowledged_by,
        "value": alarm.value,
        "limit_value": alarm.limit_value,
        "unit": alarm.unit,
        "predicted": alarm.predicted,
        "lead_time_s": alarm.lead_time_s,
        "probability": alarm.probability,
    }


def transition_document(transition: AlarmTransition) -> dict[str, Any]:
    """Show one line of the journal as plain JSON types; times as RFC 3339."""
    return {
        "alarm_id": transition.alarm_id,
        "asset": transition.asset,
        "kind": transition.kind,
        "channel": transition.channel,
        "limit_level": transition.level or None,
        "time": rfc3339(transition.time_us),
        "from": transition.from_state,
        "to": transition.to_state,
        "who": transition.who,
        "comment": transition.comment,
        "value": transition.value,
        "message": transition.message,
    }


def _time(time_us: int | None) -> str | None:
    return None if time_us is None else rfc3339(time_us)
