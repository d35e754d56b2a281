"""A sensor that sends, but nothing usable: its latest sample is not good."""

from collections.abc import Iterator

from pydantic import Field

from adapters.samples import is_good
from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_guidance import AlarmSubject, Guidance, PossibleAlarm
from service.domain.alarm_kind import DAY_S, SENSOR_FAULT, AlarmContext, AlarmKind, PlainRule
from service.domain.channels import label


class SensorFaultRule(PlainRule):
    """A sensor without a usable value."""

    off_delay_s: float = Field(10.0, ge=0, le=DAY_S)


def _conditions(context: AlarmContext, rule: SensorFaultRule) -> Iterator[AlarmCondition]:
    for channel, facts in context.channels.items():
        faulty: bool | None = False
        why = ""
        if context.good_value(channel) is None:
            sample = context.readings.latest.get(channel)
            if sample is None or context.readings.is_silent(channel, context.now_us):
                faulty = None
            elif not is_good(sample.quality):
                faulty = True
                why = f" ({context.readings.reason(channel, context.now_us)})"
        yield KIND.condition(
            context,
            rule,
            channel,
            "",
            faulty,
            f"{label(channel)}: no usable value from {facts.source}{why}",
        )


def _suppressed(context: AlarmContext, channel: str, level: str) -> str | None:
    return context.no_data(channel) or context.wrong_clock(channel)


def _points(subject: AlarmSubject, rule: SensorFaultRule) -> Iterator[PossibleAlarm]:
    return (PossibleAlarm(channel) for channel in subject.channels)


_GUIDANCE = Guidance(
    alarm_type="instrument diagnostic",
    alarm_class="instrument",
    probable_causes="wire broken or short, connector loose, sensor or amplifier failed",
    consequence_of_inaction=(
        "limits of this channel raise no alarm, and the verdict is unknown: "
        "a hot bearing may stay unseen"
    ),
    operator_action=(
        "run no heavier step and follow the neighbouring temperatures; "
        "have wire and sensor checked, replace the sensor"
    ),
    suppression="while the channel sends no data at all, or its clock is ahead",
)

KIND = AlarmKind(
    SENSOR_FAULT, SensorFaultRule, _conditions, _suppressed, points=_points, guidance=_GUIDANCE
)
