"""What a live twin and a manager of jobs are, for those who use one."""

from collections.abc import Collection, Mapping, Sequence
from typing import Literal, Protocol

from service.documents.advice import AdviceDocument
from service.documents.assets import AssetDocument, GreaseRenewed
from service.documents.base import Document
from service.documents.envelope import EnvelopeDocument
from service.documents.forecasts import WhatIf
from service.documents.identification import JobDocument, WindowDocument
from service.documents.messages import MessageType
from service.documents.models import ModelDocument
from service.documents.tags import Snapshot
from service.documents.verdicts import VerdictDocument
from service.domain.requests import IdentificationRequest, ProfileStep
from service.store import AuditEntry

DocumentKind = Literal["summary", "snapshot", "state", "verdict", "forecast", "facts", "machine"]


class Publisher(Protocol):
    """Takes live messages for whoever follows the service."""

    def publish(
        self,
        type: MessageType,
        asset: str | None,
        data: Document,
        time_us: int | None = None,
    ) -> object:
        """Give a message its number and hand it to all who want it; never waits.

        Parameters
        ----------
        type : str
            What the data are.
        asset : str or None
            Asset that it is about; None for the service as a whole.
        data : Document
            What the type of message carries; NaN and infinities become null.
        time_us : int, optional
            Process time of the data in microseconds; default now.
        """


class AssetTwin(Protocol):
    """One asset as callers see it. The synchronous methods answer from memory."""

    async def refresh(self, *kinds: DocumentKind) -> None:
        """Bring what these methods answer up to date; what cannot be had stays as it was.

        Raises
        ------
        CellUnavailableError
            If nothing was ever known.
        """

    def text(self, kind: DocumentKind) -> tuple[bytes, bytes]:
        """A document as JSON text, with a digest of it."""

    def age_s(self, kind: DocumentKind) -> float:
        """Wall seconds since a document was known to be right."""

    @property
    def id(self) -> str:
        """The asset's id in the configuration."""

    @property
    def running(self) -> bool:
        """True while the live twin is at work."""

    @property
    def channels(self) -> Mapping[str, str]:
        """Every channel of the asset with the name of its source.

        ``push`` for a pushed one, ``twin`` for the stored estimates of the service.
        """

    @property
    def temperature_names(self) -> Sequence[str]:
        """Sensors and nodes that a forecast can be asked for."""

    def summary(self) -> AssetDocument:
        """Return configuration, health and active model, as `GET /assets/{id}` shows them."""

    def snapshot(self) -> Snapshot:
        """Return the flat tags; the same object until one of them changes."""

    def verdict(self) -> VerdictDocument:
        """Return the verdict, as `GET /assets/{id}/verdict` shows it."""

    async def what_if(
        self,
        profile: Sequence[ProfileStep],
        step_s: float | None,
        nodes: Collection[str] | None,
    ) -> WhatIf:
        """Forecast a profile from the present state.

        Raises
        ------
        NotReadyError
            While the twin has no state yet.
        """

    async def renew_grease(
        self, who: str, comment: str, audit: AuditEntry | None = None
    ) -> GreaseRenewed:
        """Count the revolutions since the grease was fresh from zero again.

        The line of the audit trail is written in the transaction that keeps the new count.

        Raises
        ------
        NotReadyError
            While the twin has no state yet.
        """

    async def windows(self) -> Sequence[WindowDocument]:
        """Find the low-risk windows in the store, with operating points and score."""

    async def envelope(self) -> EnvelopeDocument:
        """Give the safe operating envelope.

        Raises
        ------
        NotReadyError
            While the twin has no state yet.
        """

    async def advice(self, speed_rpm: float, load_n: float, duration_s: float) -> AdviceDocument:
        """Rank low-risk steps by what they teach about a point.

        Raises
        ------
        NotReadyError
            While the twin has no state yet.
        NotIdentifiedError
            While the active model is not identified.
        """


class JobManager(Protocol):
    """Identification jobs, and what may become the active model."""

    async def create(
        self,
        asset_id: str,
        request: IdentificationRequest,
        idempotency_key: str | None,
        who: str,
        audit: AuditEntry | None = None,
    ) -> tuple[JobDocument, bool]:
        """Queue a job; returns it and whether it is new (False: the idempotency key matched).

        The line of the audit trail, where there is one, is written in the transaction of the
        change. So it is by the methods below.

        Raises
        ------
        JobConflictError
            While another job runs for this asset.
        RequestRefusedError
            When the request cannot be served, for example windows without data.
        KeyUsedBeforeError
            When the idempotency key stands for another request.
        """

    async def job(self, asset_id: str, job_id: str) -> JobDocument | None:
        """Return one job; None when the asset has no such job."""

    async def jobs(self, asset_id: str) -> Sequence[JobDocument]:
        """Return the jobs of an asset, newest first."""

    async def cancel(
        self, asset_id: str, job_id: str, audit: AuditEntry | None = None
    ) -> JobDocument | None:
        """Ask a job to stop and return it; None when the asset has no such job."""

    async def activate(
        self,
        asset_id: str,
        version: int,
        who: str,
        comment: str | None,
        force: bool,
        audit: AuditEntry | None = None,
    ) -> ModelDocument:
        """Make a model version the active one and switch the live twin to it.

        Raises
        ------
        ActivationRefusedError
            When the version was rejected and is not forced.
        KeyError
            When there is no such version.
        """
