"""What is known of a channel by its name: its unit, and whether an asset needs it."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

Need = Literal["required", "recommended", "optional"]


@dataclass(frozen=True, slots=True)
class ChannelNeed:
    """How much a channel is needed.

    Attributes
    ----------
    channel
        Name, or what stands for several names.
    need
        ``required``: without it there is no estimate. ``recommended``: without it something is
        assumed. ``optional``: without it something is not shown.
    without
        What happens without it.
    """

    channel: str
    need: Need
    without: str


TEMPERATURE = "a temperature"
"""Any temperature of the asset: one is required, and every further one improves the estimate."""

CHANNEL_NEEDS = (
    ChannelNeed(
        "speed_rpm", "required", "there is no estimate and no forecast; verdicts are unknown"
    ),
    ChannelNeed("load_n", "required", "there is no estimate and no forecast; verdicts are unknown"),
    ChannelNeed(
        TEMPERATURE, "required", "there is no estimate and no forecast; verdicts are unknown"
    ),
    ChannelNeed(
        "ambient_c",
        "recommended",
        "ambient is assumed: the lowest temperature measured so far, "
        "which is wrong by tens of kelvins after a start of a warm machine",
    ),
    ChannelNeed(
        "controller.plan",
        "optional",
        "the live forecast holds the present operating point",
    ),
    ChannelNeed("controller.phase", "optional", "the phase of the plan is not shown"),
    ChannelNeed(
        "controller.speed_setpoint_rpm and load_setpoint_n", "optional", "set-points are not shown"
    ),
)


def missing_channels(channels: Collection[str]) -> list[ChannelNeed]:
    """Return what is required or recommended and not there.

    Parameters
    ----------
    channels
        Names of the asset's channels.
    """
    measured = any(name.startswith("t_") for name in channels)
    there = {*channels, *([TEMPERATURE] if measured else [])}
    return [one for one in CHANNEL_NEEDS if one.need != "optional" and one.channel not in there]


def unit_of(name: str) -> str:
    """Unit of a channel or tag, from its name; empty where it has none."""
    if name.startswith("speed"):
        return "rpm"
    if name.startswith("load"):
        return "N"
    return "°C" if name.split(".")[0].endswith("_c") else ""
