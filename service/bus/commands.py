"""The interfaces of the cell's parts, and the messages that they speak in.

`service.bus.calls` makes the commands of it. As in all messages a parameter more at the end, with a
default, can be read by an older process and the other way round.
"""

from collections.abc import Sequence
from typing import Any, Final, Literal, Protocol

import msgspec

from service.bus.messages import WHILE_S, WRITTEN_S, Call
from service.bus.pushed_samples import PushedSamples
from service.documents.assets import GreaseRenewed
from service.documents.identification import JobDocument
from service.documents.interfaces import DocumentKind
from service.documents.models import ModelDocument
from service.domain.requests import IdentificationRequest
from service.domain.roles import ENGINEER, OPERATOR, PUSH, Roles
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
_OF_ENGINEERS: Final = ("take_out_of_service", "return_to_service")
_GREASE_S: Final = 10.0


# ---------------------------------------------------------------------------- assets
class Wanted(msgspec.Struct, frozen=True, array_like=True):
    """A document of an asset, and the tag of the one that is known already."""

    asset: str
    kind: DocumentKind
    tag: bytes = b""


class PackedDocument(msgspec.Struct, frozen=True, array_like=True):
    """A document as JSON text under its tag; no text where the known one is still right."""

    tag: bytes
    text: bytes | None


class Assets(Protocol):
    """The assets that the cell follows."""

    @Call()
    async def names(self) -> dict[str, int]:
        """Give the ids of all, each with a number that is another one when its table changes."""

    @Call()
    async def documents(self, wanted: list[Wanted]) -> list[PackedDocument]:
        """Give documents in the order in which they are wanted."""

    @Call(ENGINEER, patience_s=WHILE_S)
    async def apply(self) -> dict[str, str]:
        """Take up the assets that the store holds now; gives which cannot be followed, and why."""

    @Call(ENGINEER, patience_s=_GREASE_S)
    async def renew_grease(
        self, asset_id: str, who: str, comment: str, audit: AuditEntry | None = None
    ) -> GreaseRenewed:
        """Count the revolutions since the grease was fresh from zero again.

        Here as elsewhere `audit` is written together with the change that it is about. Raises
        `NotReadyError` while the twin has no state yet.
        """


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


class StreamMade(msgspec.Struct, frozen=True, array_like=True):
    """The epoch of the cell, and the number after which there are all messages of some assets."""

    epoch: str
    after: int


class LiveStream(Protocol):
    """The live messages of one cell."""

    @Call()
    async def after(self, epoch: str, number: int) -> StreamPart:
        """Give the first part of the live messages after a number of an epoch."""

    @Call()
    async def follow(self, assets: list[str] | None) -> StreamMade:
        """Make the live messages of some assets for a while, or those of all."""


# ---------------------------------------------------------------------------- pushes
class Taken(msgspec.Struct, frozen=True, array_like=True):
    """What became of pushed samples.

    Attributes
    ----------
    stored, duplicates
        How many are new on the disk, and how many were there already.
    kept_from_us
        From when on the store keeps any.
    left
        Assets of which nothing was taken: they are not followed here now.
    """

    stored: int
    duplicates: int
    kept_from_us: int
    left: list[str] = []


class Pushes(Protocol):
    """The way of pushed samples into the cell."""

    @Call(PUSH)
    async def take(
        self,
        received_us: int,
        patience_s: float,
        samples: PushedSamples,
        too_old: PushedSamples,
    ) -> Taken:
        """Accept judged samples, and those that are too old; answered when they are on the disk."""


# ---------------------------------------------------------------------------- alarms
class AlarmsPart(msgspec.Struct, frozen=True, array_like=True):
    """A part of a list of alarms.

    Attributes
    ----------
    alarms
        Those of some assets, in no order.
    followed
        Which of the cell's sets of assets they belong to (`State.followed`).
    next
        Where the next part begins; empty with the last one.
    """

    alarms: list[Alarm]
    followed: int = 0
    next: str = ""


class AcknowledgeResult(msgspec.Struct, frozen=True, array_like=True):
    """Alarms that were acknowledged, and the ids of others with why they could not be."""

    alarms: list[Alarm]
    failed: list[tuple[str, str]]


def _may_act(act: Any) -> Roles:
    return ENGINEER if act.action in _OF_ENGINEERS else OPERATOR


class Alarms(Protocol):
    """The alarm book of the cell; what is done is on the disk when a method returns."""

    @Call(shared=True)
    async def listed(
        self, normal: bool = False, asset: str | None = None, after: str = ""
    ) -> AlarmsPart:
        """Give open alarms, or normal ones, of one asset or of all, in parts.

        With `after` those of the assets whose ids come after that one.
        """

    @Call(_may_act, patience_s=WRITTEN_S)
    async def act(
        self,
        alarm: str,
        action: AlarmAction,
        who: str,
        comment: str,
        duration_s: float = 0.0,
        audit: AuditEntry | None = None,
    ) -> Alarm:
        """Do something to an alarm.

        Raises
        ------
        UnknownAlarmError
            If there is no alarm of this id.
        NotAllowedError
            If the alarm's state does not allow it.
        NotKeptError
            If neither the store nor the disk takes the change.
        """

    @Call(OPERATOR, patience_s=WRITTEN_S)
    async def acknowledge(
        self, ids: list[str], who: str, comment: str, audit: AuditEntry | None = None
    ) -> AcknowledgeResult:
        """Acknowledge several alarms."""

    @Call(merge=all)
    async def flush(self, patience_s: float) -> bool:
        """Wait until the store has every change of an alarm, for at most so many wall seconds."""


# ---------------------------------------------------------------------------- jobs
class Identifications(Protocol):
    """The jobs and models of the cell; see `service.jobs.manager.IdentificationJobs`."""

    @Call(ENGINEER, patience_s=WHILE_S, finishes=True)
    async def create(
        self,
        asset_id: str,
        request: IdentificationRequest,
        idempotency_key: str | None,
        who: str,
        audit: AuditEntry | None = None,
    ) -> tuple[JobDocument, bool]:
        """Queue a job; gives it and whether it is new."""

    @Call(patience_s=WRITTEN_S, shared=True)
    async def job(self, asset_id: str, job_id: str) -> JobDocument | None:
        """Give one job of an asset."""

    @Call(patience_s=WRITTEN_S, shared=True)
    async def jobs(self, asset_id: str) -> Sequence[JobDocument]:
        """Give all jobs of an asset, newest first."""

    @Call(ENGINEER, patience_s=WHILE_S, finishes=True)
    async def cancel(
        self, asset_id: str, job_id: str, audit: AuditEntry | None = None
    ) -> JobDocument | None:
        """Stop a job; gives it as it is then."""

    @Call(ENGINEER, patience_s=WHILE_S, finishes=True)
    async def activate(
        self,
        asset_id: str,
        version: int,
        who: str,
        comment: str | None,
        force: bool,
        audit: AuditEntry | None = None,
    ) -> ModelDocument:
        """Make a model version the active one."""


# ---------------------------------------------------------------------------- health
class HealthCheck(msgspec.Struct, frozen=True, array_like=True):
    """One thing that the service needs; the detail may name hosts and files."""

    name: str
    status: Literal["ok", "degraded", "failed"]
    detail: str


class Present(msgspec.Struct, frozen=True, array_like=True):
    """What a process says of itself every few seconds.

    Attributes
    ----------
    metrics
        Those that it does not show itself.
    publishers
        What is wrong with each of its publishers; empty where one hands everything on.
    """

    process: Literal["web", "plant"]
    resident_bytes: int
    metrics: bytes = b""
    publishers: dict[str, str] = msgspec.field(default_factory=dict)


class Presence(Protocol):
    """The processes that are there."""

    @Call(merge=all)
    async def present(self, process: Present) -> bool:
        """Note that a process is there, and how."""
