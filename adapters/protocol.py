"""The protocol that every driver follows.

A driver is an asynchronous context manager that yields batches of samples without end and reports
its own health. How to add one is described in ``docs/develop/adding-a-driver.md``.
"""

from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field
from pkgutil import resolve_name
from types import TracebackType
from typing import Protocol, Self

from pydantic import BaseModel

from adapters.configuration import MeasuredChannel, SourceConfig
from adapters.samples import Batch


class Clock(Protocol):
    """Process time: the time that the whole product runs on.

    With the virtual bench it may run faster than the wall clock.
    """

    @property
    def rate(self) -> float:
        """Process seconds per wall second."""

    def now_us(self) -> int:
        """Process time in microseconds since the epoch (UTC); callable from any thread."""

    async def sleep(self, process_seconds: float) -> None:
        """Wait this many process seconds."""


@dataclass(slots=True)
class SourceHealth:
    """How a source is doing."""

    name: str
    driver: str
    #: True while the source answers (Modbus) or sends the frames that are asked for (CAN).
    up: bool = False
    detail: str = "not started"  # one line for people: what is wrong, or that all is well
    last_good_us: int | None = None  # process time of the last good sample; None before the first
    polls: int = 0  # completed poll cycles (Modbus) or received frames (CAN)
    samples: int = 0
    #: Poll cycles left out because they came too late (Modbus), samples dropped because no one took
    #: them (CAN).
    skipped: int = 0
    reconnects: int = 0  # times that a connection was made again after a loss
    errors: dict[str, int] = field(default_factory=dict)  # number of errors by kind
    #: What is wrong with single channels, by ``asset/channel``, where the source knows.
    problems: dict[str, str] = field(default_factory=dict)
    #: By how many seconds the clocks of single channels are ahead of ours, by ``asset/channel``.
    clocks_ahead_s: dict[str, float] = field(default_factory=dict)
    #: Whether it has been listened to for long enough to say who sends its values.
    settled: bool = True

    @property
    def is_well(self) -> bool:
        """Whether it answers, and dates what it sends rightly."""
        return self.up and not self.clocks_ahead_s

    def count_error(self, kind: str) -> None:
        """Add one to the number of errors of this kind."""
        self.errors[kind] = self.errors.get(kind, 0) + 1


@dataclass(frozen=True, slots=True)
class ChannelBinding:
    """A channel of an asset and where it comes from (the driver's channel model).

    ``unit``: of the channel, into which a driver turns values whose source states another one;
    empty where there is none.
    """

    asset: str
    channel: str
    config: MeasuredChannel
    unit: str = ""


@dataclass(frozen=True, slots=True)
class PlanBinding:
    """The planned profile of an asset's controller (the driver's plan model)."""

    asset: str
    config: BaseModel


class Driver(Protocol):
    """One source of samples."""

    @property
    def name(self) -> str:
        """The source's name in the configuration."""

    async def __aenter__(self) -> Self: ...

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None: ...

    def batches(self) -> AsyncIterator[Batch]:
        """Yield batches without end, reconnecting without help; cancel to stop."""

    def health(self) -> SourceHealth:
        """Report the state of the source; cheap, from memory."""


@dataclass(frozen=True)
class DriverSpec:
    """What the service needs to know of a driver to configure and create it."""

    #: Configuration models; `plan_model` is None when the driver cannot read a plan.
    source_model: type[SourceConfig]
    channel_model: type[MeasuredChannel]
    plan_model: type[BaseModel] | None
    #: Where they are, as ``module:name``: they are imported when they are called, so that a field
    #: library is loaded only where it is used.
    check_function: str
    driver_class: str

    def check(
        self,
        source: SourceConfig,
        channels: Sequence[ChannelBinding],
        plans: Sequence[PlanBinding],
    ) -> None:
        """Check a source with all bound to it; opens no connection. Raises `ConfigurationError`."""
        resolve_name(self.check_function)(source, channels, plans)

    def create(
        self,
        source: SourceConfig,
        channels: Sequence[ChannelBinding],
        plans: Sequence[PlanBinding],
        clock: Clock,
    ) -> Driver:
        """Make the driver; it connects when it is entered."""
        driver: Driver = resolve_name(self.driver_class)(source, channels, plans, clock)
        return driver
