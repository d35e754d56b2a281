"""The standard channels of a bearing, once: name, unit, label, part and what is lost without them.

A new standard channel is one row of `STANDARD`. Channels of a network of one's own are known by the
form of their names: ``t_gearbox_oil_c`` is the temperature "Gearbox oil".
"""

from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

Part = Literal["operation", "ring", "controller"]
Need = Literal["required", "recommended", "optional"]

_NO_ESTIMATE = "there is no estimate and no forecast; verdicts are unknown"


@dataclass(frozen=True, slots=True)
class Channel:
    """What is known of a standard channel.

    - ``name``: as in configuration, store and tags.
    - ``part``: ``operation``: measured of the drive. ``ring``: a temperature of the bearing's
      rings. ``controller``: what the bench controller reports of itself. Models compute with
      `OPERATING_CHANNELS` and `RING_SENSORS`; other rows are stored, shown and watched.
    - ``limits_c``: warning and alarm limit that it has unless configured, in degrees Celsius.
    """

    name: str
    label: str
    unit: str
    part: Part
    limits_c: tuple[float, float] | None = None


STANDARD = (
    Channel("speed_rpm", "Speed", "rpm", "operation"),
    Channel("load_n", "Load", "N", "operation"),
    Channel("ambient_c", "Ambient", "°C", "operation"),
    Channel("t_inner_ring_c", "Inner ring", "°C", "ring", limits_c=(90, 105)),
    Channel("t_outer_ring_c", "Outer ring", "°C", "ring", limits_c=(80, 95)),
    Channel("phase", "Phase", "", "controller"),
    Channel("speed_setpoint_rpm", "Speed set-point", "rpm", "controller"),
    Channel("load_setpoint_n", "Load set-point", "N", "controller"),
)

_BY_NAME = {one.name: one for one in STANDARD}
_IMPORTANCE: dict[Part, int] = {"ring": 3, "operation": 2, "controller": 1}
_UNITS = {"_c": "°C", "_rpm": "rpm", "_n": "N"}


def _names(part: Part) -> tuple[str, ...]:
    return tuple(one.name for one in STANDARD if one.part == part)


SPEED, LOAD, AMBIENT = OPERATING_CHANNELS = ("speed_rpm", "load_n", "ambient_c")
"""The operating point, in the order in which models take it."""
RING_SENSORS = ("t_inner_ring_c", "t_outer_ring_c")
"""The temperatures of a bearing that models compare themselves with."""
OBSERVED_CHANNELS = tuple(
    name
    for name in (*_names("operation"), *_names("ring"))
    if name not in (*OPERATING_CHANNELS, *RING_SENSORS)
)
"""Standard channels of the machine that no model computes with."""
CONTROLLER_CHANNELS = _names("controller")
NODES = tuple(f"t_node_{number}_c" for number in range(1, 14))
"""Temperatures inside the bearing that the 14-node network estimates and that may be measured."""


@lru_cache(maxsize=4096)
def label(channel: str) -> str:
    """Name of a channel as an operator says it."""
    if channel in _BY_NAME:
        return _BY_NAME[channel].label
    return channel.removeprefix("t_").removesuffix("_c").replace("_", " ").capitalize()


def unit_of(name: str) -> str:
    """Unit of a channel or of a tag of it such as ``t_inner_ring_c.twin``; empty without one."""
    channel, _, what = name.partition(".")
    if what.startswith("time_to_"):
        return "s"
    if channel in _BY_NAME:
        return _BY_NAME[channel].unit
    return _UNITS.get(channel[channel.rfind("_") :], "") if "_" in channel else ""


def is_temperature(name: str) -> bool:
    """Whether a channel is a temperature of the machine (not of its surroundings)."""
    return name.startswith("t_") and name.endswith("_c")


def is_modelled(name: str) -> bool:
    """Whether a channel is a temperature that models compute."""
    return name.startswith("t_") and name not in OBSERVED_CHANNELS


def importance(channel: str) -> int:
    """Rank a channel for a spool that must give something up; the lowest goes first.

    What the twin computed can be computed again; a measured ring temperature cannot.
    """
    if "." in channel:
        return 0
    return _IMPORTANCE[_BY_NAME[channel].part] if channel in _BY_NAME else 1


@dataclass(frozen=True, slots=True)
class ChannelNeed:
    """How much a channel is needed.

    - ``channel``: name, or what stands for several names.
    - ``need``: ``required``: without it there is no estimate. ``recommended``: without it something
      is assumed. ``optional``: without it something is not shown.
    - ``without``: what happens without it.
    """

    channel: str
    need: Need
    without: str


TEMPERATURE = "a temperature"
"""Any temperature of the asset: one is required, and every further one improves the estimate."""

CHANNEL_NEEDS = (
    ChannelNeed(SPEED, "required", _NO_ESTIMATE),
    ChannelNeed(LOAD, "required", _NO_ESTIMATE),
    ChannelNeed(TEMPERATURE, "required", _NO_ESTIMATE),
    ChannelNeed(
        AMBIENT,
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
    """Return what is required or recommended and not there."""
    measured = any(is_modelled(name) for name in channels)
    there = {*channels, *([TEMPERATURE] if measured else [])}
    return [one for one in CHANNEL_NEEDS if one.need != "optional" and one.channel not in there]
