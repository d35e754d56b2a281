"""From the configuration to drivers: which channel of which asset comes from which source."""

import ipaddress
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from adapters.can.config import CanSource
from adapters.configuration import ConfigurationError, MeasuredChannel, suggestion
from adapters.drivers import (
    DRIVERS,
    ChannelBinding,
    Clock,
    Driver,
    DriverSpec,
    PlanBinding,
)
from service.ingest.quality import CheckLimits
from service.site.configuration import SettingsError, describe_all
from service.site.machines.operating_ranges import (
    TEMPERATURE_C,
    Range,
    operating_ranges,
    refused_beyond,
)
from service.site.settings import AssetSection, Settings

PUSH = "push"
_CONTROLLED = ("phase", "speed_setpoint_rpm", "load_setpoint_n")
_PLAN = "plan"
_DEFAULT_MAX_AGE_S = 10.0
# Of channels whose interval is observed: the age limit until it is known, and the least there is.
_UNKNOWN_AGE_S, _LEAST_AGE_S = 120.0, 10.0
_CAN_AGE_S, _LEAST_CAN_AGE_S = 10.0, 2.0
_INTERVALS_UNTIL_STALE = 5.0
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
    #: The least age limit, where the limit follows the observed interval; None: it is fixed.
    learned_from_s: float | None = None


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


@dataclass(frozen=True, slots=True)
class AssetTables:
    """The tables of an asset that the drivers check; ``key`` names it in messages."""

    key: str
    id: str
    channels: Mapping[str, dict[str, Any]]
    controller: Mapping[str, dict[str, Any]]

    @classmethod
    def of(cls, number: int, asset: AssetSection) -> "AssetTables":
        """Return those of a checked asset."""
        controller = {name: getattr(asset.controller, name) for name in (*_CONTROLLED, _PLAN)}
        given = {name: table for name, table in controller.items() if table is not None}
        return cls(f"assets[{number}]", asset.id, asset.channels, given)


def wire(settings: Settings) -> Wiring:
    """Check every source and channel of a configuration against its driver.

    Raises
    ------
    SettingsError
        One line for each error: names the key, the value and what was expected.
    """
    assets = [AssetTables.of(number, asset) for number, asset in enumerate(settings.assets)]
    wiring, errors = wire_what_can_be(dict(enumerate(settings.sources)), assets, settings.base_dir)
    if errors:
        raise SettingsError(*errors)
    ranges = {asset.id: operating_ranges(asset.bearing) for asset in settings.assets}
    channels = {
        asset: {name: _plausible(name, facts, ranges[asset]) for name, facts in known.items()}
        for asset, known in wiring.channels.items()
    }
    return Wiring(wiring.sources, channels)


def _plausible(name: str, facts: ChannelFacts, ranges: Mapping[str, Range]) -> ChannelFacts:
    """Let no speed, load or temperature be good that the machine cannot have.

    A configured `valid_range` counts up to `REFUSED_BEYOND` times the default one.
    """
    if name.startswith("t_"):
        ranges = {name: TEMPERATURE_C}
    if name not in ranges:
        return facts
    limits = facts.limits
    configured = math.isfinite(limits.low) or math.isfinite(limits.high)
    low, high = (refused_beyond(ranges) if configured else ranges)[name]
    within = replace(limits, low=max(limits.low, low), high=min(limits.high, high))
    return replace(facts, limits=within)


def wire_what_can_be(
    sources: Mapping[int, dict[str, Any]], assets: Sequence[AssetTables], base_dir: Path
) -> tuple[Wiring, list[str]]:
    """Check every source and channel against its driver, and go on after errors.

    Parameters
    ----------
    sources
        Tables of the sources by their number in the configuration.
    assets
        Whose channels and controllers are to be bound.
    base_dir
        Where relative paths begin.

    Returns
    -------
    Wiring
        Of all that is right.
    list of str
        One line per error.
    """
    errors: list[str] = []
    wired = _sources(sources, base_dir, errors)
    facts: dict[str, dict[str, ChannelFacts]] = {}
    for asset in assets:
        facts[asset.id] = {}
        channels = {f"{asset.key}.channels.{name}": table for name, table in asset.channels.items()}
        channels |= {
            f"{asset.key}.controller.{name}": asset.controller[name]
            for name in _CONTROLLED
            if name in asset.controller
        }
        for key, table in channels.items():
            name = key.rpartition(".")[2]
            try:
                found = _wire_channel(asset.id, name, table, key, wired)
            except SettingsError as error:
                errors += error.lines
            else:
                if found is not None:
                    facts[asset.id][name] = found
        if _PLAN in asset.controller:
            try:
                _wire_plan(asset, wired)
            except SettingsError as error:
                errors += error.lines
    right = [source for source in wired.values() if source is not None]
    # Also a source without channels: that its DBC file is missing is an error.
    for source in right:
        errors += _check(source)
        bound = {(one.asset, one.channel) for one in source.channels}
        for asset_id, known in facts.items():
            for name in [name for name, one in known.items() if one.source == source.name]:
                if (asset_id, name) not in bound:
                    del known[name]
    return Wiring([one for one in right if one.channels or one.plans], facts), errors


def _sources(
    tables: Mapping[int, dict[str, Any]], base_dir: Path, errors: list[str]
) -> dict[str, SourceWiring | None]:
    """Return the sources by name; None for one with an error, which is noted."""
    found: dict[str, SourceWiring | None] = {}
    for number, table in tables.items():
        name = str(table.get("name"))
        try:
            found[name] = _source(f"sources[{number}]", table, base_dir)
        except SettingsError as error:
            found[name] = None
            errors += error.lines
    return found


def _source(key: str, table: dict[str, Any], base_dir: Path) -> SourceWiring:
    driver = table.get("driver")
    if not isinstance(driver, str) or driver not in DRIVERS:
        raise SettingsError(f"{key}.driver = {driver!r}: {suggestion(str(driver), DRIVERS)}")
    name = table.get("name")
    if not isinstance(name, str) or not name or name == PUSH:
        raise SettingsError(f"{key}.name = {name!r}: expected a name other than 'push'")
    spec = DRIVERS[driver]
    return SourceWiring(name, spec, _validated(spec.source_model, table, key, base_dir=base_dir))


def _wire_channel(
    asset: str,
    name: str,
    table: dict[str, Any],
    key: str,
    sources: Mapping[str, SourceWiring | None],
) -> ChannelFacts | None:
    """Bind a channel to its source; None where the source itself has an error."""
    source_name = _source_name(table, sources, key)
    if source_name == PUSH:
        return _facts(name, PUSH, None, _validated(MeasuredChannel, table, key))
    source = sources[source_name]
    if source is None:
        return None
    config = _validated(source.spec.channel_model, table, key)
    source.channels.append(ChannelBinding(asset, name, config))
    return _facts(name, source_name, source.config, config)


def _source_name(
    table: dict[str, Any], sources: Mapping[str, SourceWiring | None], key: str
) -> str:
    name = table.get("source")
    if name is None:
        raise SettingsError(f"{key}.source: missing; expected the name of a source or 'push'")
    if name != PUSH and name not in sources:
        raise SettingsError(f"{key}.source = {name!r}: {suggestion(str(name), [*sources, PUSH])}")
    return str(name)


def _wire_plan(asset: AssetTables, sources: Mapping[str, SourceWiring | None]) -> None:
    table, key = asset.controller[_PLAN], f"{asset.key}.controller.{_PLAN}"
    source_name = _source_name(table, sources, key)
    source = sources.get(source_name)
    if source is None and source_name in sources:
        return
    if source is None or source.spec.plan_model is None:
        raise SettingsError(f"{key}.source = {source_name!r}: this source cannot carry a plan")
    source.plans.append(PlanBinding(asset.id, _validated(source.spec.plan_model, table, key)))


def _check(source: SourceWiring) -> list[str]:
    """Let the driver check what is bound to its source; what is wrong is no longer bound."""
    check, config = source.spec.check, source.config
    try:
        check(config, source.channels, source.plans)
    except ConfigurationError as error:
        whole = str(error)
    else:
        return []
    # The driver names the first error only. One by one, every channel and plan names its own.
    errors: list[str] = []

    def is_right(channels: list[ChannelBinding], plans: list[PlanBinding]) -> bool:
        try:
            check(config, channels, plans)
        except ConfigurationError as error:
            errors.append(str(error))
            return False
        return True

    source.channels = [one for one in source.channels if is_right([one], [])]
    source.plans = [one for one in source.plans if is_right([], [one])]
    if not errors:  # two that do not go together
        source.channels, source.plans = [], []
    return list(dict.fromkeys(errors or [whole]))


def _validated(
    model: type[BaseModel], table: dict[str, Any], key: str, base_dir: Path | None = None
) -> BaseModel:
    try:
        return model.model_validate(table, context={"base_dir": base_dir} if base_dir else None)
    except ValidationError as error:
        raise SettingsError(*describe_all(error, key)) from error


def _facts(
    name: str, source_name: str, source: BaseModel | None, channel: BaseModel
) -> ChannelFacts:
    max_age_s, learned_from_s = _max_age_s(source, channel)
    return ChannelFacts(
        source_name, max_age_s, _check_limits(name, source, channel), learned_from_s
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


def _max_age_s(source: BaseModel | None, channel: BaseModel) -> tuple[float, float | None]:
    """Age at which a channel is stale, and the least it may be where it is learned.

    As configured, else five poll intervals of its source, else five of its observed intervals.
    """
    configured = getattr(channel, "max_age_s", None)
    if configured is not None:
        return float(configured), None
    poll_interval_s = getattr(source, "poll_interval_s", None)
    if poll_interval_s:
        return max(_DEFAULT_MAX_AGE_S, _INTERVALS_UNTIL_STALE * poll_interval_s), None
    if isinstance(source, CanSource):
        return _CAN_AGE_S, _LEAST_CAN_AGE_S
    return _UNKNOWN_AGE_S, _LEAST_AGE_S


def is_loopback(host: str) -> bool:
    """Tell whether a listening address is reachable from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
