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


def has_own_alarm(source: str, channels: Sized) -> bool:
    """Whether a source that an asset has is an alarm when it is lost, or its only channel is.

    Who pushes a single channel is not known, and may be another one for each asset.
    """
    return source != PUSH_SOURCE or len(channels) > 1


def cause_of(asset: str, kind: str, channel: str, *, predicted: bool = False) -> Cause:
    """Say what an alarm comes of."""
    if channel.startswith(_SOURCE):
        return Cause("source", channel.removeprefix(_SOURCE))
    if kind == HISTORY_NOT_KEPT:
        return Cause("service", "clock")
    return Cause("step" if predicted else "machine", asset)


def is_shared(kind: str, channel: str) -> bool:
    """Whether an alarm is one for all assets that have it."""
    return channel.startswith(_SOURCE) or kind == HISTORY_NOT_KEPT
