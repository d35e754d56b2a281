"""Channels that every verdict needs."""

from typing import Final

from service.domain.channels import AMBIENT, LOAD, SPEED
from service.site.asset_section import AssetSection

#: Operating channels that every verdict needs.
OPERATION: Final = (SPEED, LOAD)


def judged_temperatures(settings: AssetSection) -> list[str]:
    """Temperatures that a verdict needs: all measured ones with a limit, and standard sensors.

    Where no temperature with a limit is measured, the limited ones are needed all the same: without
    them nothing can be compared with a limit.
    """
    measured = [
        name
        for name in settings.channels
        if name in settings.limits or name in settings.sensor_names
    ]
    if any(name in settings.limits for name in measured):
        return measured
    return list(dict.fromkeys((*measured, *(settings.limits or settings.sensor_names))))


def required_channels(settings: AssetSection) -> list[str]:
    """Every channel that a verdict needs."""
    ambient = [AMBIENT] if AMBIENT in settings.channels else []
    return [*judged_temperatures(settings), *OPERATION, *settings.input_names, *ambient]
