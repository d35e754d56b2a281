"""What an engineer documents of an alarm (ISA-18.2, IEC 62682), and what may be changed of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol


class WarningAndAlarm(Protocol):
    """A warning limit and an alarm limit."""

    @property
    def warning(self) -> float:
        """Where the warning is raised."""

    @property
    def alarm(self) -> float:
        """Where the alarm is raised."""


@dataclass(frozen=True, slots=True)
class Guidance:
    """The texts of the rationalisation sheet for a kind, until an engineer writes better ones.

    - ``alarm_type``: how the alarm comes about: absolute, deviation, predicted ...
    - ``alarm_class``: group of alarms that are managed alike.
    - ``probable_causes``, ``consequence_of_inaction``, ``operator_action``: for the operator. The
      action is something to do: where there is nothing to do, there is no need of an alarm.
    - ``identification_method``: how it was found that this alarm is needed.
    - ``suppression``: when it is suppressed by design.
    """

    alarm_type: str = "calculated"
    alarm_class: str = "equipment protection"
    probable_causes: str = ""
    consequence_of_inaction: str = ""
    operator_action: str = ""
    identification_method: str = "product default"
    suppression: str = "none"


@dataclass(frozen=True, slots=True)
class AlarmSubject:
    """What of an asset says which alarms it can have."""

    limits: Mapping[str, WarningAndAlarm]
    channels: Mapping[str, str]

    @property
    def temperatures(self) -> tuple[str, ...]:
        """The measured temperatures."""
        return tuple(name for name in self.channels if name.startswith("t_"))

    @property
    def sources(self) -> Mapping[str, Sequence[str]]:
        """The channels of each source."""
        found: dict[str, list[str]] = {}
        for channel, source in self.channels.items():
            found.setdefault(source, []).append(channel)
        return found


@dataclass(frozen=True, slots=True)
class PossibleAlarm:
    """One alarm that an asset can have, of a kind.

    - ``channel``, ``level``: what it is about; the level is empty where the kind has one only.
    - ``pair``: the warning and alarm that its setpoint is one of; None: it has no setpoint.
    - ``unit``: of the setpoint and the deadband.
    - ``deadband_key``: key of the deadband among the settings of the kind; empty: it has none.
    """

    channel: str
    level: str = ""
    pair: WarningAndAlarm | None = None
    unit: str | None = None
    deadband_key: str = ""

    @property
    def setpoint(self) -> float | None:
        """Where it is raised."""
        if self.pair is None:
            return None
        return self.pair.alarm if self.level == "alarm" else self.pair.warning


@dataclass(frozen=True, slots=True)
class AlarmOverride:
    """What one alarm has otherwise than its kind says; None: as the kind says."""

    setpoint: float | None = None
    deadband: float | None = None
    on_delay_s: float | None = None
    off_delay_s: float | None = None
    priority: int | None = None
    latched: bool | None = None
    re_alarm_s: float | None = None
    enabled: bool = True


AlarmName = tuple[str, str, str]
"""Kind, channel and level: what identifies an alarm of an asset."""
