"""Sensors that say nothing usable, and channels or whole sources that say nothing."""

from collections import defaultdict
from collections.abc import Iterator

from adapters.samples import is_good
from service.alarms import AlarmCondition
from service.live.rules.scene import Scene, label, source_channel


def sensor_faults(scene: Scene) -> Iterator[AlarmCondition]:
    """The latest sample of a channel is not good."""
    for channel, facts in scene.channels.items():
        sample = scene.readings.latest.get(channel)
        stale = scene.readings.is_stale(channel, scene.now_us)
        faulty = sample is not None and not stale and not is_good(sample.quality)
        why = f" ({scene.readings.reason(channel, scene.now_us)})" if faulty else ""
        yield scene.condition(
            scene.rules.sensor_fault,
            "sensor fault",
            channel,
            "",
            None if sample is None or stale else faulty,
            f"{label(channel)}: no usable value from {facts.source}{why}",
        )


def stale_data(scene: Scene) -> Iterator[AlarmCondition]:
    """No sample of a channel for too long; one alarm more where a whole source is silent."""
    rule = scene.rules.stale_data
    silent: defaultdict[str, list[bool]] = defaultdict(list)
    for channel, facts in scene.channels.items():
        silent[facts.source].append(scene.readings.is_stale(channel, scene.now_us))
    for source, channels in silent.items():
        if len(channels) > 1:
            yield scene.condition(
                rule,
                "stale data",
                source_channel(source),
                "",
                all(channels),
                f"No data from {source} ({len(channels)} channels)",
            )
    for channel, facts in scene.channels.items():
        never = " yet" if channel not in scene.readings.latest else ""
        yield scene.condition(
            rule,
            "stale data",
            channel,
            "",
            scene.readings.is_stale(channel, scene.now_us),
            f"{label(channel)}: no data from {facts.source}{never}",
        )


def allowed_age_s(max_age_s: float, rate: float) -> float:
    """Age in process seconds at which data are stale; never judged tighter than 1.5 wall s."""
    return max(max_age_s, 1.5 * rate)
