"""The protocol that every driver follows, and the registry of drivers.

A driver is an asynchronous context manager that yields batches of samples for ever and reports
its own health. How to add one is described in ``docs/adding-a-driver.md``.
"""

from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pkgutil import resolve_name
from types import MappingProxyType, TracebackType
from typing import Any, Protocol, Self

from pydantic import BaseModel

from adapters.can.config import CanChannel, CanSource
from adapters.configuration import ConfigurationError, suggestion
from adapters.modbus.config import ModbusChannel, ModbusPlan, ModbusRtuSource, ModbusTcpSource
from adapters.replay.config import ReplayChannel, ReplaySource
from adapters.samples import Batch


class UnknownDriverError(ConfigurationError):
    """There is no driver of that name."""


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
        """Wait so many process seconds."""


@dataclass(slots=True)
class SourceHealth:
    """How a source is doing.

    Attributes
    ----------
    up
        True while the source answers (Modbus) or sends the frames that are asked for (CAN).
    detail
        One line for people: what is wrong, or that all is well.
    last_good_us
        Process time of the last good sample; None before the first.
    polls
        Completed poll cycles (Modbus) or received frames (CAN).
    samples
        Samples handed over.
    skipped
        Poll cycles left out because they came too late (Modbus), samples dropped because nobody
        took them (CAN).
    reconnects
        Times that a connection was made anew after a loss.
    errors
        Number of errors by kind.
    problems
        What is wrong with single channels, by ``asset/channel``, where the source can tell.
    """

    name: str
    driver: str
    up: bool = False
    detail: str = "not started"
    last_good_us: int | None = None
    polls: int = 0
    samples: int = 0
    skipped: int = 0
    reconnects: int = 0
    errors: dict[str, int] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)

    def count_error(self, kind: str) -> None:
        """Add one to the number of errors of this kind."""
        self.errors[kind] = self.errors.get(kind, 0) + 1


@dataclass(frozen=True, slots=True)
class ChannelBinding:
    """A channel of an asset and where it comes from (the driver's channel model)."""

    asset: str
    channel: str
    config: BaseModel


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
        """Yield batches for ever, reconnecting without help; cancel to stop."""

    def health(self) -> SourceHealth:
        """Tell how the source is doing; cheap, from memory."""


Create = Callable[[Any, Sequence[ChannelBinding], Sequence[PlanBinding], Clock], Driver]
Check = Callable[[Any, Sequence[ChannelBinding], Sequence[PlanBinding]], None]


@dataclass(frozen=True)
class DriverSpec:
    """What the service needs to know of a driver to configure and create it.

    Attributes
    ----------
    source_model, channel_model, plan_model
        Configuration models; `plan_model` is None when the driver cannot read a plan.
    check
        Checks a source with everything bound to it before the service starts (reads the DBC,
        for example); raises `ConfigurationError`. Opens no connection.
    create
        Makes the driver; imports the field library only now.
    """

    source_model: type[BaseModel]
    channel_model: type[BaseModel]
    plan_model: type[BaseModel] | None
    check: Check
    create: Create


def _spec(
    source_model: type[BaseModel],
    channel_model: type[BaseModel],
    plan_model: type[BaseModel] | None,
    check: str,
    create: str,
) -> DriverSpec:
    """Describe a driver; its functions, as ``module:name``, are imported when they are called."""
    return DriverSpec(
        source_model,
        channel_model,
        plan_model,
        lambda *bound: resolve_name(check)(*bound),
        lambda *bound: resolve_name(create)(*bound),
    )


_MODBUS = (
    ModbusChannel,
    ModbusPlan,
    "adapters.modbus.mapping:check",
    "adapters.modbus.driver:ModbusDriver",
)

DRIVERS: Mapping[str, DriverSpec] = MappingProxyType(
    {
        "modbus-tcp": _spec(ModbusTcpSource, *_MODBUS),
        "modbus-rtu": _spec(ModbusRtuSource, *_MODBUS),
        "can": _spec(
            CanSource,
            CanChannel,
            None,
            "adapters.can.decoding:check",
            "adapters.can.driver:CanDriver",
        ),
        "replay": _spec(
            ReplaySource,
            ReplayChannel,
            None,
            "adapters.replay.driver:check",
            "adapters.replay.driver:ReplayDriver",
        ),
    }
)


def driver_spec(name: str) -> DriverSpec:
    """Look up a driver by its name in the configuration.

    Raises
    ------
    UnknownDriverError
        The message lists the drivers that there are.
    """
    try:
        return DRIVERS[name]
    except KeyError:
        raise UnknownDriverError(f"unknown driver {name!r}; {suggestion(name, DRIVERS)}") from None
