"""Sensors that say nothing usable, and channels or whole sources that say nothing."""

from collections.abc import Iterator

from adapters.samples import is_good
from service.alarms import AlarmCondition
from service.domain.channels import label
from service.live.rules.scene import Scene, source_channel


def sensor_faults(scene: Scene) -> Iterator[AlarmCondition]:
    """The latest sample of a channel is not good."""
    for channel, facts in scene.channels.items():
        sample = scene.readings.latest.get(channel)
        silent = scene.readings.is_silent(channel, scene.now_us)
        faulty = sample is not None and not silent and not is_good(sample.quality)
        why = f" ({scene.readings.reason(channel, scene.now_us)})" if faulty else ""
        yield scene.condition(
            scene.rules.sensor_fault,
            "sensor fault",
            channel,
            "",
            None if sample is None or silent else faulty,
            f"{label(channel)}: no usable value from {facts.source}{why}",
        )


def stale_data(scene: Scene) -> Iterator[AlarmCondition]:
    """No sample for too long: one alarm of a source that has fallen silent, else of the channel.

    What has never spoken is waited for; it raises nothing.
    """
    rule = scene.rules.stale_data
    for source, channels in scene.sources.channels.items():
        if len(channels) > 1:
            yield scene.condition(
                rule,
                "stale data",
                source_channel(source),
                "",
                scene.sources.is_lost(source),
                f"No data from {source} ({len(channels)} channels)",
                covers=tuple(channels),
            )
    for channel, facts in scene.channels.items():
        yield scene.condition(
            rule,
            "stale data",
            channel,
            "",
            scene.sources.is_lost_alone(channel),
            f"{label(channel)}: no data from {facts.source}",
        )
