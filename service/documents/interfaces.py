"""What takes live messages, and what a manager of jobs is, for those who use one."""

from collections.abc import Sequence
from typing import Literal, Protocol

from service.documents.base import Document
from service.documents.identification import JobDocument
from service.documents.messages import MessageType
from service.documents.models import ModelDocument
from service.domain.requests import IdentificationRequest
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
