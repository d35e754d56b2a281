"""Temperatures over their limits: measured, above the ambient one, and forecast."""

from collections.abc import Iterator, Mapping

from service.alarms import AlarmCondition
from service.domain.channels import AMBIENT, label
from service.live.presentation import LimitCrossing
from service.live.rules.scene import Scene


def measured_limits(scene: Scene) -> Iterator[AlarmCondition]:
    """Measured temperature at or above its warning or alarm limit."""
    rule = scene.rules.measured_limit
    for channel, limits in scene.limits.items():
        yield from scene.over_limits(
            rule,
            "measured limit",
            channel,
            scene.good_value(channel),
            limits,
            "over {level} {limit:g} °C",
            deadband=rule.deadband_k,
            unit="°C",
        )


def above_ambient(scene: Scene) -> Iterator[AlarmCondition]:
    """Measured temperature too far above the measured ambient temperature."""
    rule = scene.rules.above_ambient
    ambient_c = scene.good_value(AMBIENT)
    for channel, limits in rule.limits.items():
        value = scene.good_value(channel)
        yield from scene.over_limits(
            rule,
            "above ambient",
            channel,
            None if value is None or ambient_c is None else round(value - ambient_c, 3),
            limits,
            "over {level} {limit:g} K above ambient",
            deadband=rule.deadband_k,
            unit="K",
        )


def forecast_limits(
    scene: Scene, crossings: Mapping[str, Mapping[str, LimitCrossing]]
) -> Iterator[AlarmCondition]:
    """Forecast that exceeds a limit ahead with a probability worth an operator's attention.

    Between the probability that raises and the one that clears, an alarm stays as it is.
    """
    rule = scene.rules.forecast_limit
    for channel, levels in crossings.items():
        for level, crossing in levels.items():
            limit_c = getattr(scene.limits[channel], level)
            active: bool | None = None
            if crossing.probability >= rule.raise_probability:
                active = True
            elif crossing.probability < rule.clear_probability:
                active = False
            likely = crossing.median_s is not None
            verb = "will" if likely else "may"
            yield scene.condition(
                rule,
                "forecast limit",
                channel,
                level,
                active,
                f"{label(channel)} {verb} exceed {level} {limit_c:g} °C",
                limit_value=limit_c,
                unit="°C",
                predicted=True,
                lead_time_s=crossing.earliest_s,
                probability=crossing.probability,
            )
