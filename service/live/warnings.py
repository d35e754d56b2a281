"""Which alarm conditions of one asset hold now.

Pure rules from readings and forecast to `AlarmCondition`; delays, states and the journal are the
alarm book's. A condition is True, False, or None where it cannot be told (no good sample, within
the deadband): an alarm then stays as it is.
"""

from collections.abc import Iterator, Mapping

from adapters.samples import is_good
from service.alarms import AlarmCondition, Priority
from service.live.presentation import LimitCrossing
from service.live.readings import Readings
from service.settings import Limits
from service.wiring import ChannelFacts

LABELS = {
    "t_inner_ring_c": "Inner ring",
    "t_outer_ring_c": "Outer ring",
    "ambient_c": "Ambient",
    "speed_rpm": "Speed",
    "load_n": "Load",
}
LEVEL_PRIORITY: Mapping[str, Priority] = {"warning": 2, "alarm": 1}

# Deadband of 1 % of a 0 to 100 degree range; the delays suit a quantity that moves over minutes.
MEASURED_DEADBAND_K = 1.0
MEASURED_ON_DELAY_S = 10.0
MEASURED_OFF_DELAY_S = 60.0
# A predicted exceedance is announced from this probability and withdrawn below the lower one.
FORECAST_RAISE_PROBABILITY = 0.20
FORECAST_CLEAR_PROBABILITY = 0.10
FORECAST_OFF_DELAY_S = 120.0
SENSOR_ON_DELAY_S = 10.0
SENSOR_OFF_DELAY_S = 10.0


def label(channel: str) -> str:
    """Name of a channel as an operator says it."""
    if channel in LABELS:
        return LABELS[channel]
    return channel.removeprefix("t_").removesuffix("_c").replace("_", " ").capitalize()


def measured_limits(
    asset: str, readings: Readings, limits: Mapping[str, Limits], now_us: int
) -> Iterator[AlarmCondition]:
    """Measured temperature at or above its warning or alarm limit."""
    for channel, pair in limits.items():
        value = readings.good_value(channel, now_us)
        for level, limit_c in (("warning", pair.warning), ("alarm", pair.alarm)):
            yield AlarmCondition(
                asset=asset,
                kind="measured limit",
                channel=channel,
                level=level,
                active=None if value is None else value >= limit_c,
                value=value,
                limit_value=limit_c,
                deadband=MEASURED_DEADBAND_K,
                unit="°C",
                message=f"{label(channel)} over {level} {limit_c:g} °C",
                priority=LEVEL_PRIORITY[level],
                on_delay_s=MEASURED_ON_DELAY_S,
                off_delay_s=MEASURED_OFF_DELAY_S,
            )


def forecast_limits(
    asset: str,
    crossings: Mapping[str, Mapping[str, LimitCrossing]],
    limits: Mapping[str, Limits],
    readings: Readings,
    now_us: int,
) -> Iterator[AlarmCondition]:
    """Forecast that passes a limit ahead with a probability worth an operator's attention.

    A limit that is passed already is the matter of the measured alarm; its prediction is withdrawn.
    """
    for channel, levels in crossings.items():
        value = readings.good_value(channel, now_us)
        for level, crossing in levels.items():
            limit_c = getattr(limits[channel], level)
            active: bool | None = None
            if value is not None and value >= limit_c:
                active = False
            elif crossing.probability >= FORECAST_RAISE_PROBABILITY:
                active = True
            elif crossing.probability < FORECAST_CLEAR_PROBABILITY:
                active = False
            likely = crossing.median_s is not None
            will = "will" if likely else "may"
            yield AlarmCondition(
                asset=asset,
                kind="forecast limit",
                channel=channel,
                level=level,
                active=active,
                value=None,
                limit_value=limit_c,
                unit="°C",
                message=f"{label(channel)} {will} pass {level} {limit_c:g} °C",
                priority=LEVEL_PRIORITY[level],
                predicted=True,
                lead_time_s=crossing.median_s if likely else crossing.earliest_s,
                probability=crossing.probability,
                off_delay_s=FORECAST_OFF_DELAY_S,
            )


def sensor_conditions(
    asset: str, readings: Readings, channels: Mapping[str, ChannelFacts], now_us: int
) -> Iterator[AlarmCondition]:
    """Sensor fault (the latest sample is not good) and stale data (no sample for too long)."""
    for channel, facts in channels.items():
        sample = readings.latest.get(channel)
        stale = readings.is_stale(channel, now_us)
        faulty = sample is not None and not stale and not is_good(sample.quality)
        yield AlarmCondition(
            asset=asset,
            kind="sensor fault",
            channel=channel,
            level="",
            active=None if sample is None or stale else faulty,
            value=None,
            message=f"{label(channel)}: no usable value from {facts.source}"
            + (f" ({readings.reason(channel, now_us)})" if faulty else ""),
            priority=2,
            on_delay_s=SENSOR_ON_DELAY_S,
            off_delay_s=SENSOR_OFF_DELAY_S,
        )
        yield AlarmCondition(
            asset=asset,
            kind="stale data",
            channel=channel,
            level="",
            active=stale,
            value=None,
            message=f"{label(channel)}: no data from {facts.source}"
            + (" yet" if sample is None else ""),
            priority=2,
            on_delay_s=SENSOR_ON_DELAY_S,
            off_delay_s=SENSOR_OFF_DELAY_S,
        )


def allowed_age_s(max_age_s: float, rate: float) -> float:
    """Age in process seconds at which data are stale; never judged tighter than 1.5 wall s."""
    return max(max_age_s, 1.5 * rate)
