"""Silences as they are looked at many times a second: read once, found by asset."""

from collections.abc import Iterable
from typing import Final

import structlog
from pydantic import ValidationError

from service.clock import MICROSECONDS
from service.domain.daily_hours import DailyHours, is_within
from service.features.silences.tables import Silence

_MINUTE_US: Final = 60 * MICROSECONDS

_log = structlog.get_logger(__name__)


class SilenceTimes:
    """Says whether a silence is about an asset at a process time.

    A silence that cannot be read silences nothing.
    """

    def __init__(self, silences: Iterable[Silence] = ()) -> None:
        self._of_all: list[_Standing] = []
        self._of: dict[str, list[_Standing]] = {}
        # What was found for the process second of the last question.
        self._second = -1
        self._all_silent = False
        self._silent: dict[str, bool] = {}
        for silence in silences:
            try:
                standing = _Standing(silence)
            except ValidationError as error:  # a time zone that this machine does not have
                _log.error("silence_refused", silence=silence.id, reason=str(error))
                continue
            if not silence.assets:
                self._of_all.append(standing)
            for asset in silence.assets:
                self._of.setdefault(asset, []).append(standing)

    def covers(self, asset: str, now_us: int) -> bool:
        """Whether the alarms of an asset are not sent; what holds for a second is found once."""
        second = now_us // MICROSECONDS
        if second != self._second:
            self._second, self._silent = second, {}
            self._all_silent = _any_in_force(self._of_all, now_us)
        if self._all_silent:
            return True
        of_asset = self._of.get(asset)
        if of_asset is None:
            return False
        silent = self._silent.get(asset)
        if silent is None:
            silent = self._silent[asset] = _any_in_force(of_asset, now_us)
        return silent


class _Standing:
    """A silence whose hours and time zone are read."""

    def __init__(self, silence: Silence) -> None:
        self._begins_us, self._ends_us = silence.begins_us, silence.ends_us
        self._days = silence.days
        self._hours: DailyHours | None = None
        if silence.begins or silence.days:
            self._hours = DailyHours.model_validate(
                {
                    "begins": silence.begins or "00:00",
                    "ends": silence.ends or "23:59:59.999999",
                    "time_zone": silence.time_zone,
                }
            )
        self._minute = -1  # hours begin and end with a minute
        self._within = False

    def is_in_force(self, now_us: int) -> bool:
        """Whether it applies at a process time."""
        if not self._begins_us <= now_us < self._ends_us:
            return False
        if self._hours is None:
            return True
        minute = now_us // _MINUTE_US
        if minute != self._minute:
            self._minute, self._within = minute, is_within(self._hours, self._days, now_us)
        return self._within


def is_in_force(silence: Silence, now_us: int) -> bool:
    """Whether a silence applies at a process time."""
    try:
        return _Standing(silence).is_in_force(now_us)
    except ValidationError:
        return False


def _any_in_force(standing: Iterable[_Standing], now_us: int) -> bool:
    return any(one.is_in_force(now_us) for one in standing)
