"""``[assets.alarms]``: which alarms an asset has, and when they are raised.

Every key has a default; `docs/alarms.md` lists them. Times are process seconds.
"""

from typing import Literal, Self

from pydantic import Field, model_validator

from service.site.configuration import Section

_DAY_S = 86_400.0
_Priority = Literal[1, 2, 3]


class AlarmRule(Section):
    """What all kinds of alarms have in common."""

    enabled: bool = True
    on_delay_s: float = Field(10.0, ge=0, le=_DAY_S)
    off_delay_s: float = Field(60.0, ge=0, le=_DAY_S)
    latched: bool = False
    #: An acknowledged alarm that stands so long is raised again; 0: never.
    re_alarm_s: float = Field(8 * 3600.0, ge=0, le=30 * _DAY_S)


class PlainRule(AlarmRule):
    """An alarm of one level."""

    priority: _Priority = 2


class LevelRule(AlarmRule):
    """A warning and an alarm."""

    warning_priority: _Priority = 2
    alarm_priority: _Priority = 1

    def priority_of(self, level: str) -> _Priority:
        """Give the priority of a level."""
        return self.alarm_priority if level == "alarm" else self.warning_priority


class Levels(Section):
    """Where a warning and an alarm are raised."""

    warning: float = Field(gt=0, le=500)
    alarm: float = Field(gt=0, le=500)

    @model_validator(mode="after")
    def _warning_comes_first(self) -> Self:
        if self.warning >= self.alarm:
            raise ValueError(f"warning {self.warning:g} must be below alarm {self.alarm:g}")
        return self


class MeasuredLimitRule(LevelRule):
    """A temperature over its limit in ``[assets.limits]``."""

    # 1 % of a range of 0 to 100 degrees.
    deadband_k: float = Field(1.0, ge=0, le=50)


class AboveAmbientRule(LevelRule):
    """A temperature that is too far above the ambient one; ``limits`` in K by channel."""

    deadband_k: float = Field(1.0, ge=0, le=50)
    limits: dict[str, Levels] = Field(default_factory=dict)


class TwinDifferenceRule(LevelRule):
    """A temperature that is hotter than the model alone says, in K."""

    on_delay_s: float = Field(600.0, ge=0, le=_DAY_S)
    off_delay_s: float = Field(600.0, ge=0, le=_DAY_S)
    deadband_k: float = Field(0.5, ge=0, le=50)
    limits: Levels = Levels(warning=5.0, alarm=8.0)


class ForecastLimitRule(LevelRule):
    """A limit that the forecast passes ahead."""

    on_delay_s: float = Field(0.0, ge=0, le=_DAY_S)
    off_delay_s: float = Field(120.0, ge=0, le=_DAY_S)
    raise_probability: float = Field(0.20, gt=0, le=1)
    clear_probability: float = Field(0.10, ge=0, le=1)

    @model_validator(mode="after")
    def _clears_below(self) -> Self:
        if self.clear_probability > self.raise_probability:
            raise ValueError(
                f"clear_probability {self.clear_probability:g} must not be above "
                f"raise_probability {self.raise_probability:g}"
            )
        return self


class RateOfRiseRule(LevelRule):
    """A temperature that rises too fast, in K/min over a window."""

    window_s: float = Field(300.0, ge=60, le=3600)
    deadband_k_per_min: float = Field(0.5, ge=0, le=50)
    limits: Levels = Levels(warning=4.0, alarm=8.0)


class TwinResidualRule(PlainRule):
    """A machine that does not do what its model says, found by a sequential test."""

    priority: _Priority = 3
    on_delay_s: float = Field(0.0, ge=0, le=_DAY_S)
    off_delay_s: float = Field(0.0, ge=0, le=_DAY_S)
    #: All temperatures of the asset together, while the machine runs.
    false_alarms_per_1000_h: float = Field(0.5, gt=0, le=100)


class SensorRule(PlainRule):
    """A sensor without a usable value, or without any."""

    off_delay_s: float = Field(10.0, ge=0, le=_DAY_S)


class AlarmsSection(Section):
    """All kinds of alarms of an asset."""

    #: Below this measured speed the machine stands.
    standstill_rpm: float = Field(5.0, ge=0, le=1000)
    measured_limit: MeasuredLimitRule = MeasuredLimitRule()
    above_ambient: AboveAmbientRule = AboveAmbientRule()
    twin_difference: TwinDifferenceRule = TwinDifferenceRule()
    forecast_limit: ForecastLimitRule = ForecastLimitRule()
    rate_of_rise: RateOfRiseRule = RateOfRiseRule()
    twin_residual: TwinResidualRule = TwinResidualRule()
    sensor_fault: SensorRule = SensorRule()
    stale_data: SensorRule = SensorRule()
