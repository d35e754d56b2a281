"""From the configuration to drivers: which channel of which asset comes from which source."""

import ipaddress
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from adapters.configuration import ConfigurationError, MeasuredChannel, suggestion
from adapters.drivers import (
    DRIVERS,
    ChannelBinding,
    Clock,
    Driver,
    DriverSpec,
    PlanBinding,
    UnknownDriverError,
)
from service.configuration import SettingsError, describe
from service.ingest.quality import CheckLimits
from service.settings import AssetSection, Settings

PUSH = "push"
CONTROLLER_CHANNELS = ("phase", "speed_setpoint_rpm", "load_setpoint_n")
_DEFAULT_MAX_AGE_S = 10.0
# A PT100 in a bearing of this size follows with a time constant of seconds, and all the friction
# heat of its highest speed and load, put into one ring alone, warms that by less than 2 K/s.
_TEMPERATURE_RATE_K_PER_S = 2.0
_TEMPERATURE_JUMP_K = 5.0
# While a machine runs, noise and the hall's air move a reading of this resolution sooner.
_TEMPERATURE_FLAT_S = 1800.0
_FLAT_RESOLUTION_K = 0.2


@dataclass(slots=True)
class SourceWiring:
    """One source with all that is read from it."""

    name: str
    spec: DriverSpec
    config: BaseModel
    channels: list[ChannelBinding] = field(default_factory=list)
    plans: list[PlanBinding] = field(default_factory=list)

    def create(self, clock: Clock) -> Driver:
        """Make the driver; it connects when it is entered."""
        return self.spec.create(self.config, self.channels, self.plans, clock)


@dataclass(frozen=True, slots=True)
class ChannelFacts:
    """What the live side must know of a channel, whatever its source."""

    source: str
    max_age_s: float
    limits: CheckLimits = field(default_factory=CheckLimits)


@dataclass(frozen=True, slots=True)
class Wiring:
    """All sources, and the facts of every channel by asset."""

    sources: list[SourceWiring]
    channels: Mapping[str, Mapping[str, ChannelFacts]]

    @property
    def check_limits(self) -> dict[tuple[str, str], CheckLimits]:
        """What the values of every channel can do, by asset and channel."""
        return {
            (asset, channel): facts.limits
            for asset, channels in self.channels.items()
            for channel, facts in channels.items()
        }


def wire(settings: Settings) -> Wiring:
    """Check every source and channel of a configuration against its driver.

    Raises
    ------
    SettingsError
        One line that names the key, the value and what was expected.
    """
    try:
        return _wire(settings)
    except SettingsError:
        raise
    except ConfigurationError as error:
        raise SettingsError(str(error)) from error


def _wire(settings: Settings) -> Wiring:
    sources = dict(_sources(settings))
    facts: dict[str, dict[str, ChannelFacts]] = {}
    for number, asset in enumerate(settings.assets):
        facts[asset.id] = {}
        for channel, table, key in _channels(asset, f"assets[{number}]"):
            source_name = _source_name(table, sources, key)
            if source_name == PUSH:
                pushed = _validated(MeasuredChannel, table, key)
                facts[asset.id][channel] = _facts(channel, PUSH, None, pushed)
                continue
            source = sources[source_name]
            config = _validated(source.spec.channel_model, table, key)
            source.channels.append(ChannelBinding(asset.id, channel, config))
            facts[asset.id][channel] = _facts(channel, source_name, source.config, config)
        _wire_plan(asset, f"assets[{number}].controller.plan", sources)
    for source in sources.values():
        source.spec.check(source.config, source.channels, source.plans)
    return Wiring([source for source in sources.values() if source.channels or source.plans], facts)


def _sources(settings: Settings) -> Iterator[tuple[str, SourceWiring]]:
    for number, table in enumerate(settings.sources):
        key = f"sources[{number}]"
        driver = table.get("driver")
        if not isinstance(driver, str) or driver not in DRIVERS:
            error = UnknownDriverError(f"driver = {driver!r}: {suggestion(str(driver), DRIVERS)}")
            raise SettingsError(f"{key}.{error}")
        name = table.get("name")
        if not isinstance(name, str) or not name or name == PUSH:
            raise SettingsError(f"{key}.name = {name!r}: expected a name other than 'push'")
        spec = DRIVERS[driver]
        config = _validated(spec.source_model, table, key, base_dir=settings.base_dir)
        yield name, SourceWiring(name, spec, config)


def _channels(asset: AssetSection, key: str) -> Iterator[tuple[str, dict[str, Any], str]]:
    for channel, table in asset.channels.items():
        yield channel, table, f"{key}.channels.{channel}"
    for channel in CONTROLLER_CHANNELS:
        table = getattr(asset.controller, channel)
        if table is not None:
            yield channel, table, f"{key}.controller.{channel}"


def _source_name(table: dict[str, Any], sources: Mapping[str, SourceWiring], key: str) -> str:
    name = table.get("source")
    if name is None:
        raise SettingsError(f"{key}.source: missing; expected the name of a source or 'push'")
    if name != PUSH and name not in sources:
        raise SettingsError(f"{key}.source = {name!r}: {suggestion(str(name), [*sources, PUSH])}")
    return str(name)


def _wire_plan(asset: AssetSection, key: str, sources: Mapping[str, SourceWiring]) -> None:
    table = asset.controller.plan
    if table is None:
        return
    source_name = _source_name(table, sources, key)
    source = sources.get(source_name)
    if source is None or source.spec.plan_model is None:
        raise SettingsError(f"{key}.source = {source_name!r}: this source cannot carry a plan")
    config = _validated(source.spec.plan_model, table, key)
    source.plans.append(PlanBinding(asset.id, config))


def _validated(
    model: type[BaseModel], table: dict[str, Any], key: str, base_dir: Path | None = None
) -> BaseModel:
    try:
        return model.model_validate(table, context={"base_dir": base_dir} if base_dir else None)
    except ValidationError as error:
        raise SettingsError(describe(error, key)) from error


def _facts(
    name: str, source_name: str, source: BaseModel | None, channel: BaseModel
) -> ChannelFacts:
    return ChannelFacts(
        source_name, _max_age_s(source, channel), _check_limits(name, source, channel)
    )


def _check_limits(name: str, source: BaseModel | None, channel: BaseModel) -> CheckLimits:
    """What a channel's values can do: as configured, else by what physics lets a temperature do."""
    if not isinstance(channel, MeasuredChannel):
        return CheckLimits()
    jump = rate = flat = 0.0
    # A record that is played faster than it happened changes as much faster.
    if name.endswith("_c") and getattr(source, "speed", 1.0) <= 1.0:
        jump, rate = _TEMPERATURE_JUMP_K, _TEMPERATURE_RATE_K_PER_S
        is_whole = getattr(channel, "type", "").lstrip("u").startswith("int")
        coarse = is_whole and abs(getattr(channel, "scale", 1.0)) > _FLAT_RESOLUTION_K
        flat = 0.0 if name == "ambient_c" or coarse else _TEMPERATURE_FLAT_S
    low, high = channel.valid_range or (-math.inf, math.inf)
    return CheckLimits(
        low,
        high,
        _or_nothing(channel.max_jump, jump),
        _or_nothing(channel.max_rate_per_s, rate),
        _or_nothing(channel.flat_line_s, flat),
    )


def _or_nothing(configured: float | None, default: float) -> float:
    """Limit as configured, else by default; 0 is no limit."""
    return (default if configured is None else configured) or math.inf


def _max_age_s(source: BaseModel | None, channel: BaseModel) -> float:
    """Age at which a channel is stale: as configured, else some periods of its source."""
    configured = getattr(channel, "max_age_s", None)
    if configured is not None:
        return float(configured)
    poll_interval_s = getattr(source, "poll_interval_s", None)
    return max(_DEFAULT_MAX_AGE_S, 5.0 * poll_interval_s) if poll_interval_s else _DEFAULT_MAX_AGE_S


def is_loopback(host: str) -> bool:
    """Tell whether a listening address is reachable from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
