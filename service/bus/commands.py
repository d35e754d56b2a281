"""Everything that the cell can be asked, and what it answers."""

from array import array
from collections.abc import Iterable, Sequence
from typing import Literal

import msgspec

from adapters.samples import Sample
from service.bus.messages import Command
from service.documents.interfaces import DocumentKind
from service.notifications.states import NotificationState
from service.store import Alarm, AuditEntry

AlarmAction = Literal[
    "acknowledge",
    "comment",
    "reset",
    "return_to_service",
    "shelve",
    "take_out_of_service",
    "unshelve",
]


# ---------------------------------------------------------------------------- assets
class Wanted(msgspec.Struct, frozen=True, array_like=True):
    """A document of an asset, and the tag of the one that is known already."""

    asset: str
    kind: DocumentKind
    tag: bytes = b""


class Document(msgspec.Struct, frozen=True, array_like=True):
    """A document as JSON text under its tag; no text where the known one is still right."""

    tag: bytes
    text: bytes | None


class GetDocuments(Command[list[Document]], frozen=True, array_like=True):
    """Documents in the order in which they are wanted."""

    wanted: list[Wanted]


class AssetNames(Command[dict[str, int]], frozen=True, array_like=True):
    """The ids of all assets, each with a number that is another one when its table has changed."""


class ApplyAssets(Command[dict[str, str]], frozen=True, array_like=True):
    """Take up the assets that the store holds as they are now; answers which cannot, and why."""


class RenewGrease(Command[bytes], frozen=True, array_like=True):
    """Count the revolutions of an asset's grease from zero again; answers as JSON text."""

    asset: str
    who: str
    comment: str
    audit: AuditEntry | None = None


# ---------------------------------------------------------------------------- live messages
class StreamMessage(msgspec.Struct, frozen=True, array_like=True):
    """One live message; the text is what goes out."""

    number: int
    type: str
    asset: str | None
    text: str


class StreamPart(msgspec.Struct, frozen=True, array_like=True):
    """Live messages after a number.

    Attributes
    ----------
    number
        Up to this number nothing more is to be had.
    forgotten
        What came up to this number cannot be had any more.
    messages
        In the order of their numbers.
    """

    number: int
    forgotten: int
    messages: list[StreamMessage]


class StreamAfter(Command[StreamPart], frozen=True, array_like=True):
    """The first part of the live messages after a number of an epoch."""

    epoch: str
    number: int


class StreamMade(msgspec.Struct, frozen=True, array_like=True):
    """The epoch of the cell, and the number after which there are all messages of some assets."""

    epoch: str
    after: int


class FollowStream(Command[StreamMade], frozen=True, array_like=True):
    """Have the live messages of some assets made for a while, or those of all."""

    assets: list[str] | None


# ---------------------------------------------------------------------------- pushes
class Samples(msgspec.Struct, frozen=True, array_like=True):
    """Samples column by column, each as the bytes of an array.

    Attributes
    ----------
    channels
        Names that `channel` counts from 0.
    channel, time_us, value, quality
        One entry for each sample: unsigned short, int64, float64 and byte.
    """

    channels: list[str]
    channel: bytes
    time_us: bytes
    value: bytes
    quality: bytes

    @classmethod
    def pack(cls, samples: Sequence[Sample]) -> "Samples":
        """Write samples of one asset."""
        names = {name: number for number, name in enumerate({one.channel for one in samples})}
        return cls(
            list(names),
            array("H", [names[one.channel] for one in samples]).tobytes(),
            array("q", [one.time_us for one in samples]).tobytes(),
            array("d", [one.value for one in samples]).tobytes(),
            bytes(int(one.quality) for one in samples),
        )

    def __len__(self) -> int:
        """How many there are."""
        return len(self.quality)

    def unpack(self, asset: str, received_us: int, begin: int, end: int) -> list[Sample]:
        """Read some of them again."""
        columns: Iterable[tuple[int, int, float, int]] = zip(
            array("H", self.channel[2 * begin : 2 * end]),
            array("q", self.time_us[8 * begin : 8 * end]),
            array("d", self.value[8 * begin : 8 * end]),
            self.quality[begin:end],
            strict=True,
        )
        return [
            Sample(asset, self.channels[channel], time_us, value, quality, received_us)
            for channel, time_us, value, quality in columns
        ]


class Taken(msgspec.Struct, frozen=True, array_like=True):
    """What became of pushed samples, and from when on the store keeps any."""

    stored: int
    duplicates: int
    kept_from_us: int


class TakeSamples(Command[Taken], frozen=True, array_like=True):
    """Take judged samples of an asset in; answered when they are on the disk."""

    asset: str
    received_us: int
    patience_s: float
    samples: Samples
    too_old: Samples


# ---------------------------------------------------------------------------- alarms
class ListAlarms(Command[list[Alarm]], frozen=True, array_like=True):
    """Alarms that are not over, or those that are normal."""

    normal: bool = False


class FollowedAlarms(msgspec.Struct, frozen=True, array_like=True):
    """Alarms of a cell, and which of its sets of assets they belong to (`State.followed`)."""

    alarms: list[Alarm]
    followed: int


class ListFollowedAlarms(Command[FollowedAlarms], frozen=True, array_like=True):
    """As `ListAlarms`, of one cell among several."""

    normal: bool = False


class ActOnAlarm(Command[Alarm], frozen=True, array_like=True):
    """Do something to an alarm; answered when that is on the disk.

    Here as in other commands, `audit` is written together with the change that it tells of.
    """

    alarm: str
    action: AlarmAction
    who: str
    comment: str
    duration_s: float = 0.0
    audit: AuditEntry | None = None


class AcknowledgedAlarms(msgspec.Struct, frozen=True, array_like=True):
    """Alarms that were acknowledged, and the ids of others with why they could not be."""

    alarms: list[Alarm]
    failed: list[tuple[str, str]]


class AcknowledgeAlarms(Command[AcknowledgedAlarms], frozen=True, array_like=True):
    """Acknowledge several alarms."""

    ids: list[str]
    who: str
    comment: str
    audit: AuditEntry | None = None


class GetNotifications(Command[list[NotificationState]], frozen=True, array_like=True):
    """How each notification is."""


class TestNotification(Command[tuple[bool, str]], frozen=True, array_like=True):
    """Send a test message; answers whether it was taken, and why not or by whom not."""

    notification: str
    who: str
    audit: AuditEntry | None = None


class Flush(Command[bool], frozen=True, array_like=True):
    """Wait until the store has every change of an alarm, for at most so many wall seconds."""

    patience_s: float


# ---------------------------------------------------------------------------- jobs
class CreateJob(Command[tuple[bytes, bool]], frozen=True, array_like=True):
    """Queue an identification; the request and the job that is answered are JSON text."""

    asset: str
    request: bytes
    idempotency_key: str | None
    who: str
    audit: AuditEntry | None = None


class GetJobs(Command[bytes], frozen=True, array_like=True):
    """One job of an asset, or all, as JSON text; null where there is no such job."""

    asset: str
    job: str | None = None


class CancelJob(Command[bytes], frozen=True, array_like=True):
    """Stop a job; answers it as JSON text, null where there is no such job."""

    asset: str
    job: str
    audit: AuditEntry | None = None


class ActivateModel(Command[bytes], frozen=True, array_like=True):
    """Make a model version the active one; answers it as JSON text."""

    asset: str
    version: int
    who: str
    comment: str | None
    force: bool
    audit: AuditEntry | None = None


# ---------------------------------------------------------------------------- health
class HealthCheck(msgspec.Struct, frozen=True, array_like=True):
    """One thing that the service needs; the detail may name hosts and files."""

    name: str
    status: Literal["ok", "degraded", "failed"]
    detail: str


class CheckHealth(Command[list[HealthCheck]], frozen=True, array_like=True):
    """All checks of the cell."""


class GetMetrics(Command[bytes], frozen=True, array_like=True):
    """The metrics of the cell, as Prometheus reads them."""


class Present(Command[bool], frozen=True, array_like=True):
    """Say that a process is there, with its metrics; said again every few seconds."""

    process: Literal["web", "plant"]
    resident_bytes: int
    metrics: bytes = b""
