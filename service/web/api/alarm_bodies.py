"""Alarms, their journal and statistics as OpenAPI shows them, and what people say to them."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from service.alarms import LONGEST_SHELVING_S, AlarmState
from service.domain.requests import RequestBody
from service.web.api.bodies import Number, Page, Time

MOST_AT_ONCE = 500
_COMMENT = "load is being reduced"

Comment = Annotated[str, Field(max_length=500, description="For the journal.", examples=[_COMMENT])]
MandatoryComment = Annotated[
    str,
    Field(min_length=1, max_length=500, description="For the journal.", examples=[_COMMENT]),
]


class _Answer(BaseModel):
    model_config = ConfigDict(extra="allow")


# ---------------------------------------------------------------------------- what is said
class CommentedRequest(RequestBody):
    """An action on an alarm, with a reason if there is one."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"comment": _COMMENT}]})

    comment: Comment | None = None


class CommentRequest(RequestBody):
    """A comment, or an action that must not go without."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"comment": _COMMENT}]})

    comment: MandatoryComment


class ShelveRequest(RequestBody):
    """Set an alarm aside for a while; it comes back by itself."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"duration_s": 1800, "comment": "sensor is being changed"}]}
    )

    duration_s: float = Field(
        gt=0,
        le=LONGEST_SHELVING_S,
        description=f"Process seconds, at most {LONGEST_SHELVING_S:g} (8 h).",
    )
    comment: Comment | None = None


class AcknowledgeManyRequest(RequestBody):
    """Several alarms at once, each judged for itself."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"ids": ["5d0c9a3e7b1f4e2a9c8d7e6f5a4b3c2d"], "comment": _COMMENT}]
        }
    )

    ids: list[Annotated[str, Field(min_length=1, max_length=64)]] = Field(
        min_length=1, max_length=MOST_AT_ONCE
    )
    comment: Comment | None = None


# ---------------------------------------------------------------------------- what is answered
class Peak(_Answer):
    """The highest value while the condition was there."""

    value: float = Field(examples=[93.2])
    time: Time


class AlarmDocument(_Answer):
    """One alarm; states after ISA-18.2."""

    id: str
    asset: str = Field(examples=["bench-1"])
    kind: str = Field(examples=["forecast limit"])
    priority: int = Field(ge=1, le=3, description="1 high, 2 medium, 3 low.")
    state: AlarmState = Field(examples=["UNACK"])
    active: bool = Field(description="Whether the condition is there, whatever the state.")
    channel: str | None = Field(examples=["t_inner_ring_c"])
    message: str = Field(examples=["Inner ring will exceed warning 90 °C"])
    raised_at: Time | None = Field(
        description="Null for an alarm that was set aside before it was ever raised."
    )
    since: Time = Field(description="When the present state began.")
    acknowledged_at: Time | None
    acknowledged_by: str | None
    shelved_until: Time | None
    shelved_by: str | None
    suppressed_reason: str | None = Field(
        description="Why the alarm means nothing now, in state DSUPR.",
        examples=["standstill"],
    )
    latched: bool = Field(description="It stays after its return to normal until it is reset.")
    comment: str | None = Field(description="The latest one.")
    peak: Peak | None = Field(
        None, description="Of this alarm's life, in its `unit`; null where nothing is compared."
    )
    duration_s: Number = Field(
        None, description="Process seconds from raise to return; null until it has returned."
    )
    predicted: bool = Field(description="Not measured, but forecast.")
    lead_time_s: Number = Field(
        description="Process seconds until the limit is exceeded at the earliest (2.5 % of the "
        "forecasts), as `seconds_to_limit` of a verdict."
    )
    probability: Number


class AlarmList(Page):
    """Alarms, most urgent first."""

    items: list[AlarmDocument]


class FailedAlarm(_Answer):
    """An alarm that could not be acknowledged, and why."""

    id: str
    detail: str


class AcknowledgedAlarms(_Answer):
    """What became of several alarms."""

    items: list[AlarmDocument]
    failed: list[FailedAlarm]


class AlarmJournalLine(_Answer):
    """One change of an alarm's state, one comment, or one event."""

    kind_of_line: Literal["alarm", "event"] = Field(
        alias="class",
        description="An event (model drift, activation) asks for no answer of an operator.",
    )
    alarm_id: str | None
    asset: str
    kind: str = Field(examples=["measured limit"])
    channel: str | None
    priority: int | None
    time: Time
    event: str | None = Field(examples=["acknowledge"])
    who: str = Field(examples=["operator bt_1a2b3c4d"])
    comment: str | None
    peak: Peak | None = Field(None, description="Of the alarm's life up to this line.")
    duration_s: Number = Field(
        None, description="Process seconds from raise to return; null until it has returned."
    )
    message: str


class AlarmJournalList(Page):
    """The alarm journal, newest first."""

    items: list[AlarmJournalLine]


class FrequentAlarm(_Answer):
    """How often alarms of one kind and channel called for an operator in the last day."""

    kind: str
    channel: str | None
    count: int


class AlarmStatistics(_Answer):
    """The load that alarms are on operators; the measures of ISA-18.2 and EEMUA 191."""

    last_10_min: int = Field(description="Alarms raised in the last 10 minutes of process time.")
    flood: bool = Field(description="More than 10 of them.")
    per_10_min_average_24h: float = Field(description="Up to 1 is acceptable.")
    most_in_10_min_24h: int
    by_priority_24h: dict[str, int]
    most_frequent: list[FrequentAlarm]
    stale_over_24h: int = Field(description="Alarms that have been active for more than a day.")
