"""How much of a load the alarms are on operators, by the measures of ISA-18.2 and EEMUA 191."""

from collections.abc import Sequence
from typing import Any

from service.alarms.states import ACTIVE_STATES, UNACKNOWLEDGED_STATES, AlarmState
from service.store import Alarm, Annunciations

#: More alarms than this in ten minutes are a flood that nobody can follow.
FLOOD_IN_10_MIN = 10
_DAY_US = 86_400_000_000
_SPANS_PER_DAY = 144


def statistics_document(
    counts: Annunciations, open_alarms: Sequence[Alarm], now_us: int
) -> dict[str, Any]:
    """Put the counts of the journal and the alarms that stand into one document.

    Parameters
    ----------
    counts : Annunciations
        How often alarms called for an operator.
    open_alarms : sequence of Alarm
        Those that are not over.
    now_us : int
        Process time, UTC microseconds.
    """
    return {
        "last_10_min": counts.in_last_10_min,
        "flood": counts.in_last_10_min > FLOOD_IN_10_MIN,
        "per_10_min_average_24h": round(counts.in_last_24_h / _SPANS_PER_DAY, 4),
        "most_in_10_min_24h": counts.most_in_10_min,
        "by_priority_24h": {str(level): counts.by_priority.get(level, 0) for level in (1, 2, 3)},
        "most_frequent": [
            {"kind": one.kind, "channel": one.channel or None, "count": one.count}
            for one in counts.most_frequent
        ],
        "stale_over_24h": sum(
            alarm.state in ACTIVE_STATES and now_us - alarm.raised_at_us > _DAY_US
            for alarm in open_alarms
        ),
    }


def alarm_summary(open_alarms: Sequence[Alarm]) -> dict[str, Any]:
    """Count the alarms of one asset, and name the highest measured limit that is exceeded.

    What is shelved, suppressed or out of service is neither active nor unacknowledged. A measured
    limit that is exceeded stays so while the data of its channel are lost, whatever people have
    said to its alarm.

    Parameters
    ----------
    open_alarms : sequence of Alarm
        Those that are not over.
    """
    told = [one for one in open_alarms if one.state in ACTIVE_STATES | UNACKNOWLEDGED_STATES]
    over = {one.level for one in open_alarms if one.kind == "measured limit" and one.present}
    return {
        "active": sum(one.state in ACTIVE_STATES for one in told),
        "unacknowledged": sum(one.state in UNACKNOWLEDGED_STATES for one in told),
        "shelved": sum(one.state == AlarmState.SHLVD for one in open_alarms),
        "highest_priority": min((one.priority for one in told), default=0),
        "over_limit": next((level for level in ("alarm", "warning") if level in over), None),
    }
