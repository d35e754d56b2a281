"""What a live twin and a manager of jobs are, for those who use one."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal, Protocol

from service.domain.requests import IdentificationRequest, ProfileStep

MessageType = Literal[
    "measurement", "state", "verdict", "forecast", "alarm", "job", "health", "heartbeat"
]
DocumentKind = Literal["summary", "snapshot", "state", "verdict", "forecast", "facts", "machine"]


class Publisher(Protocol):
    """Takes live messages for whoever follows the service."""

    def publish(
        self,
        type: MessageType,
        asset: str | None,
        data: Mapping[str, Any],
        time_us: int | None = None,
    ) -> object:
        """Give a message its number and hand it to all who want it; never waits.

        Parameters
        ----------
        type : str
            What the data are.
        asset : str or None
            Asset that it is about; None for the service as a whole.
        data : mapping
            Plain JSON types; NaN and infinities become null.
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

    def summary(self) -> Mapping[str, Any]:
        """Return configuration, health and active model, as `GET /assets/{id}` shows them."""

    def snapshot(self) -> Mapping[str, Any]:
        """Return ``{"tags": {name: {"value", "unit", "quality", "time"}}}``."""

    def state(self) -> Mapping[str, Any]:
        """Return ``{"time", "model_version", "nodes": {name: {"mean_c", "std_c"}}}``."""

    def verdict(self) -> Mapping[str, Any]:
        """Return the verdict, as `GET /assets/{id}/verdict` shows it."""

    def forecast(self) -> Mapping[str, Any] | None:
        """Return the latest live forecast; None before the first."""

    async def what_if(
        self,
        profile: Sequence[ProfileStep],
        step_s: float | None,
        nodes: Collection[str] | None,
    ) -> Mapping[str, Any]:
        """Forecast a profile from the present state.

        Raises
        ------
        NotReadyError
            While the twin has no state yet.
        """

    async def renew_grease(self, who: str, comment: str) -> Mapping[str, Any]:
        """Count the revolutions since the grease was fresh from zero again.

        Raises
        ------
        NotReadyError
            While the twin has no state yet.
        """

    async def windows(self) -> Sequence[Mapping[str, Any]]:
        """Find the low-risk windows in the store, with operating points and score."""

    async def envelope(self) -> Mapping[str, Any]:
        """Give the safe operating envelope.

        Raises
        ------
        NotReadyError
            While the twin has no state yet.
        """

    async def advice(self, speed_rpm: float, load_n: float, duration_s: float) -> Mapping[str, Any]:
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
    ) -> tuple[Mapping[str, Any], bool]:
        """Queue a job; returns it and whether it is new (False: the idempotency key matched).

        Raises
        ------
        JobConflictError
            While another job runs for this asset.
        RequestRefusedError
            When the request cannot be served, for example windows without data.
        KeyUsedBeforeError
            When the idempotency key stands for another request.
        """

    async def job(self, asset_id: str, job_id: str) -> Mapping[str, Any] | None:
        """Return one job; None when the asset has no such job."""

    async def jobs(self, asset_id: str) -> Sequence[Mapping[str, Any]]:
        """Return the jobs of an asset, newest first."""

    async def cancel(self, asset_id: str, job_id: str) -> Mapping[str, Any] | None:
        """Ask a job to stop and return it; None when the asset has no such job."""

    async def activate(
        self, asset_id: str, version: int, who: str, comment: str | None, force: bool
    ) -> object:
        """Make a model version the active one and switch the live twin to it.

        Raises
        ------
        ActivationRefusedError
            When the version was rejected and is not forced.
        KeyError
            When there is no such version.
        """
