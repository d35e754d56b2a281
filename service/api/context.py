"""What the web side needs from the rest of the service, and the bodies that both understand."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol

from prometheus_client import CollectorRegistry
from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    field_validator,
)

from adapters.drivers import Clock, SourceHealth
from service.api.times import Instant
from service.live.bus import Bus
from service.settings import Settings

if TYPE_CHECKING:
    from service.alarms import AlarmBook
    from service.ingest import Ingest
    from service.store import Outbox, Store

MAX_PROFILE_HOURS = 48
MAX_PROFILE_STEPS = 200
MAX_FORECAST_ROWS = 3000
SENSORS = ("t_inner_ring_c", "t_outer_ring_c")
NODES = tuple(f"t_node_{number}_c" for number in range(1, 14))
PUSH_SOURCE = "push"


class RequestBody(BaseModel):
    """What all bodies have in common: no unknown members, no conversions, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_nul(cls, value: Any) -> Any:
        """PostgreSQL keeps no text with the character NUL, and nobody types one."""
        if isinstance(value, str) and "\x00" in value:
            raise ValueError("expected a text without the character NUL")
        return value


NodeName = Annotated[
    str,
    Field(
        pattern=r"^t_[a-z0-9_]+_c$",
        max_length=100,
        description=f"{', '.join(SENSORS)}, {NODES[0]} to {NODES[-1]}, or a sensor or node of the "
        "asset's own network.",
        examples=["t_inner_ring_c"],
    ),
]


class ProfileStep(RequestBody):
    """So long at this speed, radial load and, if given, ambient temperature."""

    duration_s: float = Field(
        gt=0, le=MAX_PROFILE_HOURS * 3600, description="Length of the step in seconds."
    )
    speed_rpm: float = Field(ge=0, le=20_000, description="Speed in revolutions per minute.")
    load_n: float = Field(ge=0, le=200_000, description="Radial load in newtons.")
    ambient_c: float | None = Field(
        None,
        ge=-40,
        le=80,
        description="Ambient temperature in degrees Celsius; absent: as it is now.",
    )


class ForecastRequest(RequestBody):
    """A what-if: the profile to be forecast from the present state of the twin."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "profile": [
                        {"duration_s": 1800, "speed_rpm": 4200, "load_n": 2650},
                        {"duration_s": 3600, "speed_rpm": 6200, "load_n": 5500, "ambient_c": 24},
                    ],
                    "step_s": 60,
                    "nodes": ["t_inner_ring_c", "t_outer_ring_c"],
                }
            ]
        }
    )

    profile: list[ProfileStep] = Field(
        min_length=1,
        max_length=MAX_PROFILE_STEPS,
        description=f"The steps in order, together at most {MAX_PROFILE_HOURS} h.",
    )
    step_s: float | None = Field(
        None,
        gt=0,
        le=3600,
        description=f"Spacing of the answer in seconds, at most {MAX_FORECAST_ROWS} rows.",
    )
    nodes: list[NodeName] | None = Field(
        None, min_length=1, description="Sensors and nodes to be answered; absent: all."
    )

    @field_validator("profile")
    @classmethod
    def _not_too_long(cls, profile: list[ProfileStep]) -> list[ProfileStep]:
        total_s = sum(step.duration_s for step in profile)
        if total_s > MAX_PROFILE_HOURS * 3600:
            raise ValueError(
                f"the steps last {total_s:g} s together, expected at most "
                f"{MAX_PROFILE_HOURS * 3600} s ({MAX_PROFILE_HOURS} h)"
            )
        return profile

    @field_validator("step_s")
    @classmethod
    def _not_too_many_rows(cls, step_s: float | None, info: ValidationInfo) -> float | None:
        total_s = sum(step.duration_s for step in info.data.get("profile", ()))
        if step_s is not None and total_s / step_s > MAX_FORECAST_ROWS:
            raise ValueError(
                f"{step_s:g} s gives {total_s / step_s:.0f} rows over the profile of "
                f"{total_s:g} s, expected at most {MAX_FORECAST_ROWS}"
            )
        return step_s


class GreaseRenewedRequest(RequestBody):
    """Why the grease was renewed."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"comment": "regreased, 18 g of the same grease"}]}
    )

    comment: str | None = Field(None, max_length=500, description="For the journal.")


class TimeWindow(RequestBody):
    """A span of process time, start inclusive and end exclusive."""

    start: Instant
    end: Instant

    @field_validator("end")
    @classmethod
    def _end_is_later(cls, end: int, info: ValidationInfo) -> int:
        if end <= info.data.get("start", end - 1):
            raise ValueError("expected an end later than the start")
        return end


class IdentificationRequest(RequestBody):
    """What to identify from, and how."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"windows": "auto", "method": "noa+refine", "seed": 0}]}
    )

    windows: Annotated[
        Annotated[Literal["auto"], Tag("auto")]
        | Annotated[list[TimeWindow], Field(min_length=1, max_length=100), Tag("list")],
        Discriminator(lambda given: "list" if isinstance(given, list) else "auto"),
    ] = Field(
        "auto",
        description="`auto` takes the low-risk windows of the store, else these windows.",
    )
    method: Literal["noa+refine", "refine", "noa"] = "noa+refine"
    seed: int = Field(0, ge=0, le=2**32 - 1, description="Seed of the search.")
    budget: int | None = Field(
        None, ge=100, le=5_000_000, description="Most evaluations; absent: the method's own."
    )


class JobConflictError(Exception):
    """A job runs for this asset already.

    Parameters
    ----------
    job : mapping
        The running job as the API shows it.
    """

    def __init__(self, job: Mapping[str, Any]) -> None:
        super().__init__(f"identification {job['id']} is {job['status']}")
        self.job = job


class KeyUsedBeforeError(Exception):
    """An idempotency key came again with another request; the text says what was expected."""


class ActivationRefusedError(Exception):
    """A model version may not be activated; the text says why."""


class RequestRefusedError(ValueError):
    """A request that is well-formed but cannot be served as it is.

    Parameters
    ----------
    pointer : str
        JSON pointer into the body, for example ``/windows/0``.
    detail : str
        What is wrong and what was expected.
    """

    def __init__(self, pointer: str, detail: str) -> None:
        super().__init__(f"{pointer}: {detail}")
        self.pointer = pointer
        self.detail = detail


class NotReadyError(RuntimeError):
    """The twin cannot answer yet; the text says what it waits for."""


class NotIdentifiedError(RuntimeError):
    """There is no identified model yet; the text says what to do."""


class AssetTwin(Protocol):
    """The live runtime of one asset. All but the asynchronous methods answer from memory."""

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


@dataclass(frozen=True, slots=True)
class ServiceContext:
    """Everything the web side leans on, put together by the service."""

    settings: Settings
    clock: Clock
    store: "Store"
    outbox: "Outbox"
    bus: Bus
    ingest: "Ingest"
    alarms: "AlarmBook"
    assets: Mapping[str, AssetTwin]
    jobs: JobManager
    registry: CollectorRegistry
    sources: Callable[[], Sequence[SourceHealth]]
    problems: Callable[[], Mapping[str, str | None]] = dict
