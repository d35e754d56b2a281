"""The present state of one alarm condition, as alarm kinds report it."""

from dataclasses import dataclass
from typing import Literal

EventKind = Literal[
    "model drift",
    "model not trusted",
    "model trusted again",
    "model activated",
    "model rolled back",
    "grease renewed",
    "asset not followed",
    "asset followed again",
]
"""What is worth a line in the journal, but needs no response of an operator."""
Priority = Literal[1, 2, 3]


# Not frozen: a frozen one takes five times as long to make, and dozens of each asset are made every
# second. Nobody changes one.
@dataclass(slots=True)
class AlarmCondition:
    """The present truth of one alarm condition; (asset, kind, channel, level) names it.

    Attributes
    ----------
    asset, channel : str
        What it is about.
    kind : str
        Name of the alarm kind, see `service.alarm_kinds`.
    level : str
        The limit's level, "warning" or "alarm"; empty for a condition without levels.
    active : bool or None
        Whether the condition holds; None when that cannot be told (no good sample): then the
        alarm stays as it is and its delays stand still.
    value : float or None
        The quantity that is compared, in ``unit``.
    message : str
        One line for operators.
    priority : int
        1 high, 2 medium, 3 low.
    predicted : bool
        True when this is not measured but forecast; then ``lead_time_s`` and ``probability``.
    lead_time_s, probability : float or None
        Process seconds until it is expected to happen, and how probable that is.
    on_delay_s, off_delay_s : float
        Process seconds that the condition must hold before the alarm is raised, and must be gone
        before the alarm returns to normal.
    limit_value : float or None
        The upper limit that the value is compared with, in ``unit``.
    deadband : float
        The alarm returns only when the value is this far below the limit, in ``unit``.
    unit : str or None
        Unit of value, limit and deadband.
    latched : bool
        The alarm stays after its return to normal until it is reset.
    re_alarm_s : float
        An acknowledged alarm that stands this many process seconds is raised again; 0: never.
    suppressed_reason : str or None
        Why the alarm means nothing now (suppressed by design); None where it does.
    covers : tuple of str
        Channels whose alarms of the same cause are acknowledged and shelved with this one.
    """

    asset: str
    kind: str
    channel: str
    level: str
    active: bool | None
    value: float | None
    message: str
    priority: Priority
    predicted: bool = False
    lead_time_s: float | None = None
    probability: float | None = None
    on_delay_s: float = 0.0
    off_delay_s: float = 0.0
    limit_value: float | None = None
    deadband: float = 0.0
    unit: str | None = None
    latched: bool = False
    re_alarm_s: float = 0.0
    suppressed_reason: str | None = None
    covers: tuple[str, ...] = ()

    @property
    def key(self) -> tuple[str, str, str, str]:
        """What tells one condition from another."""
        return self.asset, self.kind, self.channel, self.level

    @property
    def in_deadband(self) -> bool:
        """True when the value is not above the limit, but not clear enough for a return."""
        return (
            self.value is not None
            and self.limit_value is not None
            and self.limit_value - self.deadband < self.value <= self.limit_value
        )
