"""What an alarm comes of: one cause has one alarm, whatever number of assets it has."""

from collections.abc import Sized
from typing import Final, Literal, NamedTuple

from service.domain.requests import PUSH_SOURCE

CauseKind = Literal["source", "machine", "step", "service"]

STALE_DATA: Final = "stale data"
#: Samples from before the history that is kept: as a rule the clock of the service is wrong.
HISTORY_NOT_KEPT: Final = "history not kept"
_SOURCE: Final = "source:"


class Cause(NamedTuple):
    """What an alarm comes of.

    Attributes
    ----------
    kind
        A source that many assets are read from, the service itself, a machine, or a step that
        lies ahead of it.
    id
        Name of the source, part of the service, or id of the asset.
    """

    kind: CauseKind
    id: str


def source_channel(source: str) -> str:
    """Name under which a whole source stands among the channels of alarms."""
    return f"{_SOURCE}{source}"


def source_of(channel: str) -> str:
    """Give the source that a channel of an alarm stands for; empty where it is an ordinary one."""
    return channel.removeprefix(_SOURCE) if channel.startswith(_SOURCE) else ""


def has_own_alarm(source: str, channels: Sized) -> bool:
    """Whether a source that an asset has is an alarm when it is lost, or its only channel is.

    Who pushes a single channel is not known, and may be another one for each asset.
    """
    return source != PUSH_SOURCE or len(channels) > 1


def cause_of(asset: str, kind: str, channel: str, *, predicted: bool = False) -> Cause:
    """Say what an alarm comes of."""
    if source := source_of(channel):
        return Cause("source", source)
    if kind == HISTORY_NOT_KEPT:
        return Cause("service", "clock")
    return Cause("step" if predicted else "machine", asset)


def is_shared(kind: str, channel: str) -> bool:
    """Whether an alarm is one for all assets that have it."""
    return bool(source_of(channel)) or kind == HISTORY_NOT_KEPT
