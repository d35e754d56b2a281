"""Alarms, their journal and their statistics."""

from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from service.alarms.records import assets_of, duration_s
from service.alarms.states import ACTIVE_STATES, UNACKNOWLEDGED_STATES, AlarmState
from service.clock import DAY_US, rfc3339
from service.documents.base import Document, Number, Page, Time, time_or_none
from service.domain.causes import CauseKind, cause_of
from service.store import Alarm, AlarmTransition, Annunciations

#: More alarms than this in ten minutes are a flood that no one can follow.
FLOOD_IN_10_MIN = 10
_SPANS_PER_DAY = 144


class Peak(Document):
    """The highest value while the condition was there."""

    value: float = Field(examples=[93.2])
    time: Time


class AlarmCause(Document):
    """What an alarm comes of; one cause has one alarm, whatever number of assets it has."""

    kind: CauseKind = Field(
        description="A `source` that assets are read from, the `service` itself, a `machine`, or "
        "a `step` that lies ahead of it.",
        examples=["source"],
    )
    id: str = Field(
        description="Name of the source, part of the service, or id of the asset.",
        examples=["gateway-1"],
    )


class AlarmDocument(Document):
    """One alarm; states after ISA-18.2."""

    id: str
    asset: str | None = Field(
        description="Null where it is about several: see `assets`.", examples=["bench-1"]
    )
    assets: list[str] = Field(
        description="All that have it now; of one that has returned all that had it.",
        examples=[["bench-1"]],
    )
    cause: AlarmCause
    action: None = Field(description="What would clear a predicted alarm; not computed yet.")
    kind: str = Field(examples=["forecast limit"])
    channel: str = Field(
        description="Empty for an alarm of the asset as a whole.", examples=["t_inner_ring_c"]
    )
    limit_level: str | None = Field(
        description="Which limit: `warning` or `alarm`; null where there is none.",
        examples=["warning"],
    )
    priority: int = Field(ge=1, le=3, description="1 high, 2 medium, 3 low.")
    state: AlarmState = Field(examples=["UNACK"])
    active: bool = Field(description="Whether the condition is there, whatever the state.")
    message: str = Field(examples=["Inner ring may exceed warning 90 °C, 82 %"])
    raised_at: Time | None = Field(
        description="Null for an alarm that was suppressed before it was raised."
    )
    since: Time = Field(description="When the present state began.")
    returned_at: Time | None = Field(description="When the condition was last gone.")
    acknowledged_at: Time | None
    acknowledged_by: str | None
    shelved_until: Time | None
    shelved_by: str | None
    suppressed_reason: str | None = Field(
        description="Reason of the suppression, in state DSUPR.",
        examples=["standstill"],
    )
    latched: bool = Field(description="It stays after its return to normal until it is reset.")
    comment: str | None = Field(description="The latest one.")
    value: Number = Field(description="Last value that was compared, in `unit`.", examples=[91.5])
    limit_value: Number = Field(description="What it is compared with, in `unit`.", examples=[90])
    unit: str | None = Field(description="Null where nothing is compared.", examples=["°C"])
    peak: Peak | None = Field(
        description="Of this alarm's life, in its `unit`; null where nothing is compared."
    )
    duration_s: Number = Field(
        description="Process seconds from raise to return; null until it has returned."
    )
    predicted: bool = Field(description="Not measured, but forecast.")
    lead_time_s: Number = Field(
        description="Process seconds until the limit is exceeded at the earliest (2.5 % of the "
        "forecasts), as `seconds_to_limit` of a verdict."
    )
    probability: Number = Field(description="That the limit is exceeded; of a forecast only.")


class AlarmList(Page):
    """Alarms, most urgent first."""

    items: list[AlarmDocument]


class FailedAlarm(Document):
    """An alarm that could not be acknowledged, and why."""

    id: str
    detail: str


class AcknowledgedAlarms(Document):
    """What became of several alarms."""

    items: list[AlarmDocument]
    failed: list[FailedAlarm]


class AlarmJournalLine(Document):
    """One change of an alarm's state, one comment, or one event."""

    line_class: Literal["alarm", "event"] = Field(
        alias="class",
        description="An event (model drift, activation) needs no response of an operator.",
    )
    alarm_id: str | None = Field(description="Null for an event.")
    asset: str | None = Field(description="Null where it is about several: see `assets`.")
    assets: list[str]
    kind: str = Field(examples=["measured limit"])
    channel: str | None
    limit_level: str | None = Field(description="Which limit; null where there is none.")
    priority: int | None
    time: Time
    event: str | None = Field(examples=["acknowledge"])
    from_state: str | None = Field(
        alias="from", description="State before; null for an event.", examples=["UNACK"]
    )
    to_state: str | None = Field(
        alias="to", description="State after; null for an event.", examples=["ACKED"]
    )
    who: str = Field(examples=["operator bt_1a2b3c4d"])
    comment: str | None
    shelved_until: Time | None
    value: Number = Field(description="That was compared last, in `unit`.")
    unit: str | None = Field(description="Null where nothing is compared.", examples=["°C"])
    peak: Peak | None = Field(description="Of the alarm's life up to this line.")
    duration_s: Number = Field(
        description="Process seconds from raise to return; null until it has returned."
    )
    message: str


class AlarmJournalList(Page):
    """The alarm journal, newest first."""

    items: list[AlarmJournalLine]


class FrequentAlarm(Document):
    """How often alarms of one kind and channel called for an operator in the last day."""

    kind: str
    channel: str | None
    count: int


class AlarmStatistics(Document):
    """Alarm performance by the measures of ISA-18.2 and EEMUA 191."""

    last_10_min: int = Field(description="Alarms raised in the last 10 minutes of process time.")
    flood: bool = Field(description=f"More than {FLOOD_IN_10_MIN} of them.")
    per_10_min_average_24h: float = Field(description="Up to 1 is acceptable.")
    most_in_10_min_24h: int
    by_priority_24h: dict[str, int] = Field(
        description="Alarms raised in the last day, by priority.",
        examples=[{"1": 0, "2": 3, "3": 1}],
    )
    most_frequent: list[FrequentAlarm]
    stale_over_24h: int = Field(description="Alarms that have been active for more than a day.")


class AlarmSummary(Document):
    """The open alarms of an asset, counted.

    What is shelved, suppressed or out of service is neither active nor unacknowledged.
    """

    active: int
    unacknowledged: int
    shelved: int
    highest_priority: int = Field(ge=0, le=3, description="1 to 3; 0: none.")
    over_limit: Literal["warning", "alarm"] | None = Field(
        description="The highest measured limit that is exceeded, also while its data are lost."
    )


def alarm_document(alarm: Alarm) -> AlarmDocument:
    """Show one alarm."""
    assets = assets_of(alarm)
    cause = cause_of(alarm.asset, alarm.kind, alarm.channel, predicted=alarm.predicted)
    return AlarmDocument(
        id=alarm.id,
        asset=assets[0] if len(assets) == 1 else None,
        assets=list(assets),
        cause=AlarmCause(kind=cause.kind, id=cause.id),
        action=None,
        kind=alarm.kind,
        channel=alarm.channel,
        limit_level=alarm.level or None,
        priority=alarm.priority,
        state=AlarmState(alarm.state),
        active=alarm.present,
        message=alarm.message,
        raised_at=time_or_none(alarm.raised_at_us or None),
        since=rfc3339(alarm.since_us),
        returned_at=time_or_none(alarm.returned_at_us),
        acknowledged_at=time_or_none(alarm.acknowledged_at_us),
        acknowledged_by=alarm.acknowledged_by,
        shelved_until=time_or_none(alarm.shelved_until_us),
        shelved_by=alarm.shelved_by,
        suppressed_reason=alarm.suppressed_reason,
        latched=alarm.latched,
        comment=alarm.comment,
        value=alarm.value,
        limit_value=alarm.limit_value,
        unit=alarm.unit,
        peak=_peak(alarm.peak_value, alarm.peak_at_us),
        duration_s=duration_s(alarm),
        predicted=alarm.predicted,
        lead_time_s=alarm.lead_time_s,
        probability=alarm.probability,
    )


def transition_document(line: AlarmTransition, unit: str | None) -> AlarmJournalLine:
    """Show one line of the journal, with the unit of its alarm."""
    assets = line.assets or (line.asset,)
    return AlarmJournalLine(
        line_class="alarm" if line.alarm_id else "event",
        alarm_id=line.alarm_id,
        asset=assets[0] if len(assets) == 1 else None,
        assets=list(assets),
        kind=line.kind,
        channel=line.channel or None,
        limit_level=line.level or None,
        priority=line.priority,
        time=rfc3339(line.time_us),
        event=line.event or None,
        from_state=line.from_state or None,
        to_state=line.to_state or None,
        who=line.who,
        comment=line.comment,
        shelved_until=time_or_none(line.until_us),
        value=line.value,
        unit=unit,
        peak=_peak(line.peak_value, line.peak_at_us),
        duration_s=line.duration_s,
        message=line.message,
    )


def statistics_document(
    counts: Annunciations, open_alarms: Sequence[Alarm], now_us: int
) -> AlarmStatistics:
    """Put the counts of the journal and the open alarms into one document."""
    return AlarmStatistics(
        last_10_min=counts.in_last_10_min,
        flood=counts.in_last_10_min > FLOOD_IN_10_MIN,
        per_10_min_average_24h=round(counts.in_last_24_h / _SPANS_PER_DAY, 4),
        most_in_10_min_24h=counts.most_in_10_min,
        by_priority_24h={str(level): counts.by_priority.get(level, 0) for level in (1, 2, 3)},
        most_frequent=[
            FrequentAlarm(kind=one.kind, channel=one.channel or None, count=one.count)
            for one in counts.most_frequent
        ],
        stale_over_24h=sum(
            alarm.state in ACTIVE_STATES and now_us - alarm.raised_at_us > DAY_US
            for alarm in open_alarms
        ),
    )


def alarm_summary(open_alarms: Sequence[Alarm]) -> AlarmSummary:
    """Count the alarms of one asset, and name the highest measured limit that is exceeded.

    A measured limit that is exceeded stays so while the data of its channel are lost, whatever
    people have said to its alarm.
    """
    counted = [one for one in open_alarms if one.state in ACTIVE_STATES | UNACKNOWLEDGED_STATES]
    over = {one.level for one in open_alarms if one.kind == "measured limit" and one.present}
    over_limit: Literal["warning", "alarm"] | None = "warning" if "warning" in over else None
    return AlarmSummary(
        active=sum(one.state in ACTIVE_STATES for one in counted),
        unacknowledged=sum(one.state in UNACKNOWLEDGED_STATES for one in counted),
        shelved=sum(one.state == AlarmState.SHLVD for one in open_alarms),
        highest_priority=min((one.priority for one in counted), default=0),
        over_limit="alarm" if "alarm" in over else over_limit,
    )


def _peak(value: float | None, time_us: int | None) -> Peak | None:
    if value is None or time_us is None:
        return None
    return Peak(value=value, time=rfc3339(time_us))
