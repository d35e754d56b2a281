"""The present state of one alarm condition, as alarm kinds report it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Literal

from service.domain.causes import is_shared

EventKind = Literal[
    "model drift",
    "model not trusted",
    "model trusted again",
    "model activated",
    "model rolled back",
    "grease renewed",
    "asset not followed",
    "asset followed again",
    "change not taken",
    "configuration not used",
    "notification refused",
]
"""What is worth a line in the journal, but needs no response of an operator."""
Priority = Literal[1, 2, 3]
Seen = tuple[int, float | None]
"""When a value was, and the value; None where none was good."""


@dataclass(frozen=True, slots=True)
class SinceLastLook:
    """What channels were since the last look of the alarms.

    - ``seen``: by channel, in order, without those that sent nothing.
    - ``before``: by channel, what it was at the last look; None where that is not known.
    """

    seen: Mapping[str, Sequence[Seen]] = field(default_factory=dict)
    before: Mapping[str, float | None] = field(default_factory=dict)


_GONE, _IN_DEADBAND, _OVER = range(3)


# Not frozen: a frozen one takes five times as long to make, and dozens of each asset are made every
# second. They do not change.
@dataclass(slots=True)
class AlarmCondition:
    """The present truth of one alarm condition; (asset, kind, channel, level) names it.

    - ``kind``: name of the alarm kind, see `service.alarm_kinds`.
    - ``level``: the limit's level, "warning" or "alarm"; empty for a condition without levels.
    - ``active``: whether the condition holds; None when that is unknown (no good sample): then
      the alarm stays as it is and its delays stand still.
    - ``value``: the quantity that is compared, in ``unit``.
    - ``priority``: 1 high, 2 medium, 3 low.
    - ``predicted``: True when this is not measured but forecast; then ``lead_time_s`` and
      ``probability``.
    - ``lead_time_s``, ``probability``: process seconds until it is expected to happen, and how
      probable that is.
    - ``on_delay_s``, ``off_delay_s``: process seconds that the condition must hold before the alarm
      is raised, and must be gone before the alarm returns to normal.
    - ``limit_value``: the upper limit that the value is compared with, in ``unit``.
    - ``deadband``: the alarm returns only when the value is this far below the limit, in ``unit``.
    - ``unit``: unit of value, limit and deadband.
    - ``latched``: the alarm stays after its return to normal until it is reset.
    - ``re_alarm_s``: an acknowledged alarm that stands this many process seconds is raised again;
      0: never.
    - ``suppressed_reason``: why the alarm means nothing now (suppressed by design); None where it
      does.
    - ``covers``: channels whose alarms of the same cause are acknowledged and shelved with this
      one.
    - ``assets``: of a condition that many assets share: those that have it, or could have it while
      it does not hold. ``asset`` is then the one under which its alarm is kept.
    - ``between``: what the value was since the last look at the condition, the latest sample
      included; it holds at or over ``limit_value``. Empty where the present alone is known.
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
    assets: tuple[str, ...] = ()
    between: Sequence[Seen] = ()
    _key: tuple[str, str, str, str] | None = field(
        default=None, init=False, repr=False, compare=False
    )

    @property
    def key(self) -> tuple[str, str, str, str]:
        """What identifies a condition; asked for several times in each step, and made once."""
        key = self._key
        if key is None:
            asset = "" if is_shared(self.kind, self.channel) else self.asset
            self._key = key = asset, self.kind, self.channel, self.level
        return key

    @property
    def in_deadband(self) -> bool:
        """True when the value is not above the limit, but not clear enough for a return."""
        return (
            self.value is not None
            and self.limit_value is not None
            and self.limit_value - self.deadband < self.value <= self.limit_value
        )

    @property
    def was_active(self) -> bool:
        """Whether it held at any time since the last look."""
        limit = self.limit_value
        return limit is not None and any(
            value is not None and value >= limit for _, value in self.between
        )

    def since_last_look(self, from_us: int) -> Iterator[tuple[int, "AlarmCondition"]]:
        """Give the condition as it was at the times that matter, after a time.

        They are the ends of each stay over the limit, in the deadband, below it or unknown, and the
        highest value of it.
        """
        for zone, run in groupby(self.between, key=self._zone):
            seen = [one for one in run if one[0] > from_us]
            highest = max(seen, key=lambda one: one[1] or 0.0, default=None)
            for one in seen:
                if one in (seen[0], highest, seen[-1]):
                    at_us, value = one
                    holds = None if zone is None else zone == _OVER
                    yield at_us, replace(self, value=value, active=holds, between=())

    def _zone(self, seen: Seen) -> int | None:
        value, limit = seen[1], self.limit_value
        if value is None or limit is None:
            return None
        return _OVER if value >= limit else _IN_DEADBAND if value > limit - self.deadband else _GONE

    @property
    def holds(self) -> bool | None:
        """Whether it holds at this moment, whatever was before; None when that is not known.

        Between the thresholds an alarm that stands goes on, but nothing begins: a forecast whose
        probability is known and does not raise does not hold.
        """
        if self.active is None and self.probability is not None:
            return False
        return self.active
