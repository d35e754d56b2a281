"""Whether a whole source has fallen silent, or one of its channels alone."""

from collections import defaultdict
from collections.abc import Mapping

from adapters.samples import Quality
from service.domain.causes import has_own_alarm
from service.live.readings import Readings
from service.site.wiring import ChannelFacts


class Sources:
    """Distinguishes a lost source from a lost channel.

    A channel is lost alone when its source has sent something since the channel fell silent. As
    long as it has not, the source is lost: one cause, one alarm. After a source has come back its
    channels get their usual time before they are missed one by one.

    Parameters
    ----------
    facts : mapping of str to ChannelFacts
        Every channel of the asset.
    readings : Readings
        What they say.

    Attributes
    ----------
    channels : mapping of str to list of str
        The channels of every source.
    """

    def __init__(self, facts: Mapping[str, ChannelFacts], readings: Readings) -> None:
        channels: defaultdict[str, list[str]] = defaultdict(list)
        for channel, of in facts.items():
            channels[of.source].append(channel)
        self.channels: Mapping[str, list[str]] = dict(channels)
        self._facts = facts
        self._readings = readings
        self._spoken: set[str] = set()
        self._lost: dict[str, bool | None] = {}
        self._alone: dict[str, bool | None] = {}
        self._back_us: dict[str, int] = {}

    @property
    def spoken(self) -> list[str]:
        """Channels that have ever sent something, for `restore` after a restart."""
        return sorted(self._spoken)

    def restore(self, spoken: list[str]) -> None:
        """Take up which channels had sent something before a restart: they are missed again."""
        self._spoken |= set(spoken) & set(self._facts)

    def is_lost(self, source: str) -> bool | None:
        """Return whether the whole source is silent; None while it is waited for."""
        return self._lost.get(source)

    def is_lost_alone(self, channel: str) -> bool | None:
        """Return whether the channel is silent while its source is not; None if that is open."""
        return self._alone.get(channel)

    def clock_set(self, by_us: int) -> None:
        """Give channels their usual time all the same: the clock was set by so much."""
        for source in self._back_us:
            self._back_us[source] += by_us

    def look(self, now_us: int) -> None:
        """Judge all sources and channels as they are now."""
        latest = self._readings.latest
        if not latest.keys() <= self._spoken:
            self._spoken |= set(latest) & set(self._facts)
        for source, channels in self.channels.items():
            silent = {
                channel: self._silent_since_us(channel, now_us)
                for channel in channels
                if channel in self._spoken
            }
            before = self._lost.get(source)
            self._lost[source] = self._is_silent(silent) if silent else None
            if before and not self._lost[source]:
                self._back_us[source] = now_us
            for channel in channels:
                self._alone[channel] = self._judge(source, channel, silent, now_us)

    def _is_silent(self, silent: Mapping[str, int | None]) -> bool:
        """Whether a source has sent nothing since one of its channels fell silent."""
        since_us = [one for one in silent.values() if one is not None]
        return bool(since_us) and max(map(self._heard_us, silent)) <= max(since_us)

    def _judge(
        self, source: str, channel: str, silent: Mapping[str, int | None], now_us: int
    ) -> bool | None:
        if channel not in silent:
            return None
        if silent[channel] is None:
            return False
        if not has_own_alarm(source, self.channels[source]):
            return True
        grace_us = 1e6 * self._readings.age_limit_s(channel)
        back_us = self._back_us.get(source)
        waits = back_us is not None and 0 <= now_us - back_us <= grace_us
        return None if self._lost[source] or waits else True

    def _heard_us(self, channel: str) -> int:
        """When the source last sent something of the channel; 0 if it has not."""
        sample = self._readings.latest.get(channel)
        if sample is None or sample.quality == Quality.COMM_FAILURE:
            return 0
        return sample.received_us

    def _silent_since_us(self, channel: str, now_us: int) -> int | None:
        """When a channel that has spoken fell silent; None while it is not."""
        readings = self._readings
        limit_us = round(1e6 * readings.age_limit_s(channel))
        sample = readings.latest.get(channel)
        if sample is None:  # silent since a restart
            since_us = readings.began_us + limit_us
            return since_us if abs(now_us - readings.began_us) > limit_us else None
        if sample.quality == Quality.COMM_FAILURE:
            return sample.received_us
        if not readings.is_stale(channel, now_us):
            return None
        return min(sample.time_us, sample.received_us) + limit_us
