"""What the store hands out and takes in of alarms and their journal; times in process time."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Alarm:
    """One life cycle of an alarm, from its raise until it is normal and acknowledged.

    ``value`` and ``limit_value`` are in ``unit``; ``since_us`` is when the present state began;
    ``raised_at_us`` is 0 for one that was set aside before it was ever raised; ``present`` is what
    was last known of its condition, delays included; ``comment`` is the latest one;
    ``peak_value`` is the highest value while the condition was there; ``assets`` are those of a
    cause that many share, of which ``asset`` is the one under which the alarm is kept.
    """

    id: str
    asset: str
    kind: str
    channel: str
    level: str
    state: str
    priority: int
    message: str
    predicted: bool
    raised_at_us: int
    since_us: int
    returned_at_us: int | None
    acknowledged_at_us: int | None
    acknowledged_by: str | None
    value: float | None
    limit_value: float | None
    unit: str | None
    lead_time_s: float | None
    probability: float | None
    present: bool
    latched: bool
    shelved_until_us: int | None
    shelved_by: str | None
    suppressed_reason: str | None
    comment: str | None
    peak_value: float | None = None
    peak_at_us: int | None = None
    assets: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class AlarmTransition:
    """One line of the alarm journal: who or what moved an alarm from one state to another.

    A comment leaves the state as it is. ``until_us`` is when shelving ends; ``duration_s``
    is how long the condition was there, once it has returned. A line without an
    alarm is an event: worth knowing, but no alarm; its states and level are empty.
    """

    alarm_id: str | None
    asset: str
    kind: str
    channel: str
    level: str
    time_us: int
    from_state: str
    to_state: str
    who: str
    comment: str
    value: float | None
    message: str
    event: str = ""
    priority: int | None = None
    until_us: int | None = None
    peak_value: float | None = None
    peak_at_us: int | None = None
    duration_s: float | None = None
    assets: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class AlarmJournalPage:
    """Part of the alarm journal, newest first.

    - ``next_cursor``: None on the last page.
    - ``units``: in which values and peaks are, by the id of the alarm; only where it has one.
    """

    items: list[AlarmTransition]
    next_cursor: int | None
    units: Mapping[str | None, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class JournalFilter:
    """Which lines of the alarm journal are asked for; what is None does not matter.

    - ``start_us``, ``end_us``: process time, UTC microseconds; the start is included, the end is
      not.
    - ``events``: only events, or only what happened to alarms.
    """

    asset: str | None = None
    alarm_id: str | None = None
    start_us: int | None = None
    end_us: int | None = None
    events: bool | None = None


@dataclass(frozen=True, slots=True)
class AlarmCount:
    """How often alarms of one kind and channel called for an operator."""

    kind: str
    channel: str
    count: int


@dataclass(frozen=True, slots=True)
class Annunciations:
    """How many times alarms called for an operator (became UNACK).

    - ``in_last_10_min``, ``in_last_24_h``: up to now.
    - ``most_in_10_min``: in the worst of the last day's spans of ten minutes, counted from now
      backwards.
    - ``by_priority``: in the last day.
    - ``most_frequent``: in the last day, most frequent first.
    """

    in_last_10_min: int
    in_last_24_h: int
    most_in_10_min: int
    by_priority: Mapping[int, int]
    most_frequent: list[AlarmCount]
